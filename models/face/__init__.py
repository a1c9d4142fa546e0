"""Deformable surfaces under weak perspective: shapes, poses, textures, outlines."""
