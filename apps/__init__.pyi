from .background.application import build_model
from .trackers.body import BodyTracker
from .trackers.face import FaceTracker
from .trackers.objects import ObjectTracker
from .trackers.points import PointTracker
from .trackers.tracker import TrackerState

__all__ = [
    "BodyTracker",
    "FaceTracker",
    "ObjectTracker",
    "PointTracker",
    "TrackerState",
    "build_model",
]
