"""Events in zones and at lines of the image: entries, exits, crossings, stays and standing."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
