"""Runs over films: what an application says of itself, and the loop, the log and the sinks of all of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
