"""What surrounds factor analysis: association of tracks, shapes that grow."""
