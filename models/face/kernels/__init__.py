"""Compiled loops over the texels and triangles of a surface."""
