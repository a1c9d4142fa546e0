"""Compiled loops of association."""
