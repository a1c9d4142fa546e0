"""Generated scenes with exact ground truth: a street, a cylinder, a face, a signer."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
