"""What the world looks like: features, pictures, colours. No time, no engine."""

from .categorical import Categorical
from .frame import Frame
from .pixel_labels import PixelLabels

__all__ = ["Categorical", "Frame", "PixelLabels"]
