"""Compiled loops of the association of tracks."""
