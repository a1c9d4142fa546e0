from .background.application import build_model
from .trackers import (
    BodyTracker,
    FaceTracker,
    ObjectTracker,
    PointTracker,
    TrackerState,
)

__all__ = [
    "BodyTracker",
    "FaceTracker",
    "ObjectTracker",
    "PointTracker",
    "TrackerState",
    "build_model",
]
