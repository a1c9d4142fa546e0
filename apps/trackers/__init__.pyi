from .body import TrackedBody
from .face import TrackedFace
from .objects import Objects
from .points import Points

__all__ = ["Objects", "Points", "TrackedBody", "TrackedFace"]
