"""What happens to zones and lines of the picture: who enters, leaves, crosses, stays and stands still."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
