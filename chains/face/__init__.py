"""G-flow: pose, deformation and texture of an object, tracked jointly."""
