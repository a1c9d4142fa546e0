"""Compiled loops over all pixels of a frame."""
