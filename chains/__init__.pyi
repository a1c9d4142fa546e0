from .adaptive_background import AdaptiveBackground
from .articulated_pose import ArticulatedPose
from .blob_tracker import BlobTracker
from .camera_motion import CameraMotion
from .condensation import Condensation
from .detector_rates import DetectorRates
from .factor_structure import FactorStructure
from .feature_matcher import FeatureMatcher
from .flesh_tracker import FleshTracker
from .gflow import GFlow
from .ground_plane import GroundPlane
from .mixture_background import MixtureBackground
from .object_trajectories import ObjectTrajectories
from .point_tracker import PointTracker
from .recursive_structure import RecursiveStructure
from .scene_filter import SceneFilter

__all__ = [
    "AdaptiveBackground",
    "ArticulatedPose",
    "BlobTracker",
    "CameraMotion",
    "Condensation",
    "DetectorRates",
    "FactorStructure",
    "FeatureMatcher",
    "FleshTracker",
    "GFlow",
    "GroundPlane",
    "MixtureBackground",
    "ObjectTrajectories",
    "PointTracker",
    "RecursiveStructure",
    "SceneFilter",
]
