"""How beliefs move: what chains and features promise, the graph of them, and the engines."""

from importlib import import_module

import lazy_loader

_own, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_names, "Condensation"]


def __getattr__(name: str) -> object:
    # Condensation is a chain, which was here once.
    return import_module("rsmcm.chains").Condensation if name == "Condensation" else _own(name)
