"""How beliefs move: what chains and features promise, the graph of them, and the engines."""

from ..chains.condensation import Condensation
from .core.coordinate_ascent import CoordinateAscent, Solution
from .core.graph import MultiChain
from .core.protocols import (
    BatchChain,
    BatchIncoming,
    Cavity,
    Chain,
    FeatureNode,
    Incoming,
    Message,
    Port,
    Smoothed,
)
from .core.recursive_bp import Belief, RecursiveBP, RunState

__all__ = [
    "BatchChain",
    "BatchIncoming",
    "Belief",
    "Cavity",
    "Chain",
    "Condensation",
    "CoordinateAscent",
    "FeatureNode",
    "Incoming",
    "Message",
    "MultiChain",
    "Port",
    "RecursiveBP",
    "RunState",
    "Smoothed",
    "Solution",
]
