"""Boxes and masks of moving objects."""
