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
]
