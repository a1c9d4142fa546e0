from .engine.coordinate_ascent import CoordinateAscent, Solution
from .engine.graph import MultiChain
from .engine.protocols import (
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
from .engine.recursive_bp import Belief, RecursiveBP, RunState

__all__ = [
    "BatchChain",
    "BatchIncoming",
    "Belief",
    "Cavity",
    "Chain",
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
