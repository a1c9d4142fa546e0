"""Camera models: affine maps of a moving camera, perspective cameras."""
