"""Structure from motion: factor analysis, perspective cameras, deforming shapes."""
