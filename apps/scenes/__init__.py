"""Generated scenes with exact ground truth: a street for background and tracks, a cylinder for shapes."""

from .street import Scene, TruthBox, sleeping_man
from .turning_cylinder import Cylinder, cylinder

__all__ = ["Cylinder", "Scene", "TruthBox", "cylinder", "sleeping_man"]
