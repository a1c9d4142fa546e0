"""Compiled loops of G-flow."""
