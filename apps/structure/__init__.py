"""The structure application: shape and camera motion from points."""
