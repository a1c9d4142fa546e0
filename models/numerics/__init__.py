"""Compiling, threads and rotations."""
