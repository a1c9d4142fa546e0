"""Compiled loops of factor analysis."""
