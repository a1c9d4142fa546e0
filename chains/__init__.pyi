from .body.articulated_pose import ArticulatedPose
from .body.condensation import Condensation
from .body.flesh_tracker import FleshTracker
from .face.gflow import GFlow
from .objects.blob_tracker import BlobTracker
from .objects.detector_rates import DetectorRates
from .objects.ground_plane import GroundPlane
from .objects.object_trajectories import ObjectTrajectories
from .objects.scene_filter import SceneFilter
from .pixels.adaptive_background import AdaptiveBackground
from .pixels.camera_motion import CameraMotion
from .pixels.mixture_background import MixtureBackground
from .points.feature_matcher import FeatureMatcher
from .points.point_tracker import PointTracker
from .reconstruction import Reconstruction, reconstruct
from .structure.factor_structure import FactorStructure
from .structure.nonrigid_structure import NonrigidStructure
from .structure.recursive_structure import RecursiveStructure

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
    "NonrigidStructure",
    "ObjectTrajectories",
    "PointTracker",
    "Reconstruction",
    "RecursiveStructure",
    "SceneFilter",
    "reconstruct",
]
