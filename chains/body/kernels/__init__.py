"""Compiled loops over poses of a body."""
