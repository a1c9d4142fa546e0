from .engine.coordinate_ascent import CoordinateAscent, Solution
from .engine.graph import MultiChain
from .engine.protocols import (
    BatchChain,
    BatchIncoming,
    Cavity,
    Chain,
    FeatureNode,
    Incoming,
    LazyFrames,
    Message,
    Port,
    SettlingMessage,
    Smoothed,
    Trajectory,
)
from .engine.recursive_bp import Belief, RecursiveBP, RunState
from .kalman import kinematic
from .validity import (
    PredictionErrors,
    RecordedPredictions,
    compare_predictions,
    compare_scores,
    cost,
    product_of,
)

__all__ = [
    "BatchChain",
    "BatchIncoming",
    "Belief",
    "Cavity",
    "Chain",
    "CoordinateAscent",
    "FeatureNode",
    "Incoming",
    "LazyFrames",
    "Message",
    "MultiChain",
    "Port",
    "PredictionErrors",
    "RecordedPredictions",
    "RecursiveBP",
    "RunState",
    "SettlingMessage",
    "Smoothed",
    "Solution",
    "Trajectory",
    "compare_predictions",
    "compare_scores",
    "cost",
    "kinematic",
    "product_of",
]
