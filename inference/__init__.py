"""How beliefs move: what chains and features promise, the graph of them, and the engines."""

from .graph import MultiChain
from .protocols import Chain, FeatureNode, Incoming, Message
from .recursive_bp import Belief, RecursiveBP, RunState

__all__ = ["Belief", "Chain", "FeatureNode", "Incoming", "Message", "MultiChain", "RecursiveBP", "RunState"]
