"""Compiled loops over all pixels."""
