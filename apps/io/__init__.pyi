from .detections import Detections, read_detections, with_boxes
from .files import MaskWriter
from .ground_truth import BoxTruth, MaskTruth, read_ground_truth
from .keypoints import Keypoints, read_keypoints, with_keypoints
from .point_files import frames_of_tracks, read_points
from .sources.open_source import Source, open_source
from .tracks import TrackWriter, read_tracks

__all__ = [
    "BoxTruth",
    "Detections",
    "Keypoints",
    "MaskTruth",
    "MaskWriter",
    "Source",
    "TrackWriter",
    "frames_of_tracks",
    "open_source",
    "read_detections",
    "read_ground_truth",
    "read_keypoints",
    "read_points",
    "read_tracks",
    "with_boxes",
    "with_keypoints",
]
