"""Loops of the registration of pictures."""
