from .body.parts import BodyParts, PartMessage
from .body.upper_body import BodyPoses, UpperBody
from .core.categorical import Categorical, CategoricalMessage
from .core.frame import KEYPOINTS, Frame, GivenBoxes, GivenKeypoints
from .core.gaussian_message import GaussianFeature, GaussianMessage
from .core.gaussian_mixtures import GaussianMixtures
from .face.detectors import HaarFaces, YuNetFaces
from .face.morphable_model import MorphableModel, Poses
from .objects.box_message import BoxDetector, BoxMessage, LogOdds
from .objects.object_boxes import ObjectBoxes
from .pixels.layers import Layer, LayerStack
from .pixels.pixel_labels import PixelLabels, PixelMessage, ScenePixels
from .points.point_tracks import PointMessage, PointTracks, frames_of_tracks, noise_of_tracks

__all__ = [
    "KEYPOINTS",
    "BodyParts",
    "BodyPoses",
    "BoxDetector",
    "BoxMessage",
    "Categorical",
    "CategoricalMessage",
    "Frame",
    "GaussianFeature",
    "GaussianMessage",
    "GaussianMixtures",
    "GivenBoxes",
    "GivenKeypoints",
    "HaarFaces",
    "Layer",
    "LayerStack",
    "LogOdds",
    "MorphableModel",
    "ObjectBoxes",
    "PartMessage",
    "PixelLabels",
    "PixelMessage",
    "PointMessage",
    "PointTracks",
    "Poses",
    "ScenePixels",
    "UpperBody",
    "YuNetFaces",
    "frames_of_tracks",
    "noise_of_tracks",
]
