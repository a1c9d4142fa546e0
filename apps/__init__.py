"""Command line, run loop, readers and writers, pages, scenes and experiments."""
