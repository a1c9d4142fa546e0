from .body import BodyTracker, TrackedBody
from .face import FaceTracker, TrackedFace
from .objects import Objects, ObjectTracker
from .points import Points, PointTracker
from .tracker import TrackerState

__all__ = [
    "BodyTracker",
    "FaceTracker",
    "ObjectTracker",
    "Objects",
    "PointTracker",
    "Points",
    "TrackedBody",
    "TrackedFace",
    "TrackerState",
]
