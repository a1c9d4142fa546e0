"""Compiled loops over small patches."""
