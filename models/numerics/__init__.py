"""Compiling, threads and arrays that are used again."""
