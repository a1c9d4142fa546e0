"""How beliefs move: what chains and features promise, the graph of them, and the engines."""

from importlib import import_module

from .core.coordinate_ascent import CoordinateAscent, Solution
from .core.graph import MultiChain
from .core.protocols import BatchChain, Chain, FeatureNode, Incoming, Message
from .core.recursive_bp import Belief, RecursiveBP, RunState

__all__ = [
    "BatchChain",
    "Belief",
    "Chain",
    "Condensation",
    "CoordinateAscent",
    "FeatureNode",
    "Incoming",
    "Message",
    "MultiChain",
    "RecursiveBP",
    "RunState",
    "Solution",
]


def __getattr__(name: str) -> object:
    if name == "Condensation":  # a chain, which was here once; not imported at once, since chains import us
        return getattr(import_module("rsmcm.chains"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
