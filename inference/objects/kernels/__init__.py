"""Compiled loops of objects."""
