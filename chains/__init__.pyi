from .adaptive_background import AdaptiveBackground
from .articulated_pose import ArticulatedPose
from .blob_tracker import BlobTracker
from .condensation import Condensation
from .detector_rates import DetectorRates
from .factor_structure import FactorStructure
from .flesh_tracker import FleshTracker
from .gflow import GFlow
from .ground_plane import GroundPlane
from .mixture_background import MixtureBackground
from .point_tracker import PointTracker
from .recursive_structure import RecursiveStructure

__all__ = [
    "AdaptiveBackground",
    "ArticulatedPose",
    "BlobTracker",
    "Condensation",
    "DetectorRates",
    "FactorStructure",
    "FleshTracker",
    "GFlow",
    "GroundPlane",
    "MixtureBackground",
    "PointTracker",
    "RecursiveStructure",
]
