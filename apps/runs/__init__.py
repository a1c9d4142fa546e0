"""Runs over videos: the protocol of an application, and the loop, log and sinks of all applications."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
