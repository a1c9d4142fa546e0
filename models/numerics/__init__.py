"""Compiling, threads, rotations and arrays that are used again."""
