"""Command line, run loop, readers and writers, pages, scenes, experiments, and trackers of single images."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
