"""What the world looks like: features, pictures, colours. No time, no engine."""

from .body_parts import BodyParts
from .body_poses import BodyPoses
from .categorical import Categorical
from .face_detectors import HaarFaces, YuNetFaces
from .frame import Frame
from .morphable_model import MorphableModel
from .object_boxes import ObjectBoxes
from .pixel_labels import PixelLabels
from .point_tracks import PointTracks
from .pose import Poses
from .upper_body import UpperBody

__all__ = [
    "BodyParts",
    "BodyPoses",
    "Categorical",
    "Frame",
    "HaarFaces",
    "MorphableModel",
    "ObjectBoxes",
    "PixelLabels",
    "PointTracks",
    "Poses",
    "UpperBody",
    "YuNetFaces",
]
