"""Compiled loops over the masks of objects."""
