"""What the world looks like: features, pictures, colours. No time, no engine."""

from .categorical import Categorical
from .frame import Frame
from .morphable_model import MorphableModel
from .object_boxes import ObjectBoxes
from .pixel_labels import PixelLabels
from .point_tracks import PointTracks
from .pose import Poses

__all__ = ["Categorical", "Frame", "MorphableModel", "ObjectBoxes", "PixelLabels", "PointTracks", "Poses"]
