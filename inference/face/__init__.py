"""G-flow: experts of pose, and the textures that they remember."""
