"""Pixel labels, and the predictions of pixels that chains exchange."""
