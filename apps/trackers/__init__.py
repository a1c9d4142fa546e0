"""Trackers that are given one image after the other, of `rsmcm.apps`, and what they return."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
