"""Tracking moving objects: blobs in the pixels, and the ground that they stand on."""
