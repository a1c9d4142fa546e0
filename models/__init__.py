"""What the world looks like: features, pictures, colours. No time, no engine."""

from .categorical import Categorical
from .frame import Frame
from .object_boxes import ObjectBoxes
from .pixel_labels import PixelLabels
from .point_tracks import PointTracks

__all__ = ["Categorical", "Frame", "ObjectBoxes", "PixelLabels", "PointTracks"]
