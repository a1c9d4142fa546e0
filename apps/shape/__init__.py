"""The shape application: from tracks of points to a thing that deforms."""
