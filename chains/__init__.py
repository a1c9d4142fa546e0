"""Pluggable chains, one a file."""

from .adaptive_background import AdaptiveBackground
from .blob_tracker import BlobTracker
from .factor_structure import FactorStructure
from .gflow import GFlow
from .ground_plane import GroundPlane
from .mixture_background import MixtureBackground
from .point_tracker import PointTracker
from .recursive_structure import RecursiveStructure

__all__ = [
    "AdaptiveBackground",
    "BlobTracker",
    "FactorStructure",
    "GFlow",
    "GroundPlane",
    "MixtureBackground",
    "PointTracker",
    "RecursiveStructure",
]
