import rsmcm.chains.condensation

from .core.coordinate_ascent import CoordinateAscent, Solution
from .core.graph import MultiChain
from .core.protocols import BatchChain, Chain, FeatureNode, Incoming, Message
from .core.recursive_bp import Belief, RecursiveBP, RunState

Condensation = rsmcm.chains.condensation.Condensation

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
