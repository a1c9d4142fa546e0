"""How beliefs move: what chains and features promise, the graph of them, and the engines."""

from .condensation import Condensation
from .coordinate_ascent import CoordinateAscent, Solution
from .graph import MultiChain
from .protocols import BatchChain, Chain, FeatureNode, Incoming, Message
from .recursive_bp import Belief, RecursiveBP, RunState

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
