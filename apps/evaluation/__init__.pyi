from .masks import ErrorClasses, PixelScore, PixelScores, error_classes, mask_error_classes
from .scoring import Scoring
from .tracks import TrackScores, evaluate_tracks
from .validity import report_validity

__all__ = [
    "ErrorClasses",
    "PixelScore",
    "PixelScores",
    "Scoring",
    "TrackScores",
    "error_classes",
    "evaluate_tracks",
    "mask_error_classes",
    "report_validity",
]
