from .body.articulated_pose import ArticulatedPose
from .body.condensation import Condensation
from .body.dynamics import BodyDynamics
from .body.fixed_lag import FixedLag
from .body.flesh_tracker import FleshTracker
from .body.hand_labelling import Labelling
from .body.samples import BodySamples, body_moments
from .face.gflow import GFlow
from .generic import DiscreteChain, LinearGaussianChain, ParticleChain
from .objects.blob_tracker import BlobTracker
from .objects.detector_rates import DetectorRates
from .objects.ground_plane import GroundPlane
from .objects.object_trajectories import ObjectTrajectories
from .objects.scene_filter import SceneFilter, SceneModel
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
    "BodyDynamics",
    "BodySamples",
    "CameraMotion",
    "Condensation",
    "DetectorRates",
    "DiscreteChain",
    "FactorStructure",
    "FeatureMatcher",
    "FixedLag",
    "FleshTracker",
    "GFlow",
    "GroundPlane",
    "Labelling",
    "LinearGaussianChain",
    "MixtureBackground",
    "NonrigidStructure",
    "ObjectTrajectories",
    "ParticleChain",
    "PointTracker",
    "Reconstruction",
    "RecursiveStructure",
    "SceneFilter",
    "SceneModel",
    "body_moments",
    "reconstruct",
]
