"""Frames from films, pictures, cameras and streams."""
