"""Compiled loops over poses of bodies."""
