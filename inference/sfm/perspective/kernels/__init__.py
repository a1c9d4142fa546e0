"""Compiled loops of bundle adjustment."""
