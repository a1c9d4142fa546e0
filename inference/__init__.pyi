import rsmcm.chains.body.condensation

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

Condensation = rsmcm.chains.body.condensation.Condensation

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
