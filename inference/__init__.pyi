import rsmcm.chains.condensation

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

Condensation = rsmcm.chains.condensation.Condensation

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
