from .body.parts import BodyParts
from .body.upper_body import BodyPoses, UpperBody
from .core.categorical import Categorical
from .core.frame import Frame, GivenBoxes, GivenKeypoints
from .face.detectors import HaarFaces, YuNetFaces
from .face.morphable_model import MorphableModel, Poses
from .objects.object_boxes import ObjectBoxes
from .pixels.layers import Layer, LayerStack
from .pixels.pixel_labels import PixelLabels, PixelMessage, ScenePixels
from .points.point_tracks import PointTracks, frames_of_tracks

__all__ = [
    "BodyParts",
    "BodyPoses",
    "Categorical",
    "Frame",
    "GivenBoxes",
    "GivenKeypoints",
    "HaarFaces",
    "Layer",
    "LayerStack",
    "MorphableModel",
    "ObjectBoxes",
    "PixelLabels",
    "PixelMessage",
    "PointTracks",
    "Poses",
    "ScenePixels",
    "UpperBody",
    "YuNetFaces",
    "frames_of_tracks",
]
