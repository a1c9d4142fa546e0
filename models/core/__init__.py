"""Frames, messages and the files that they come from: what every domain uses."""
