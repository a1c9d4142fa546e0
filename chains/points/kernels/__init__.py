"""Compiled loops over descriptors."""
