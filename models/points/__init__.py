"""Points in the picture, what they look like, and affine cameras that see them."""
