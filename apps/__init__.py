"""Command line, video, scenes, reports and experiments."""
