"""How beliefs move: what chains and features promise, the graph of them, and the engines."""

from ..chains.condensation import Condensation
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
