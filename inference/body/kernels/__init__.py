"""Compiled densities of a body's dynamics."""
