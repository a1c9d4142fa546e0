"""Pluggable chains, one a file."""

from .adaptive_background import AdaptiveBackground
from .blob_tracker import BlobTracker
from .ground_plane import GroundPlane
from .mixture_background import MixtureBackground

__all__ = ["AdaptiveBackground", "BlobTracker", "GroundPlane", "MixtureBackground"]
