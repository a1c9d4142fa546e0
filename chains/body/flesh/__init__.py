"""Tracking of head and hands in the picture by several hypotheses."""
