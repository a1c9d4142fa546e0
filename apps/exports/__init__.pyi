from .coco import to_coco, to_cvat
from .finished_run import FinishedRun, RunFrame, read_tracks_table
from .for_supervision import to_supervision
from .motchallenge import to_motchallenge
from .movement import movement_dataset, to_movement
from .video import to_video

__all__ = [
    "FinishedRun",
    "RunFrame",
    "movement_dataset",
    "read_tracks_table",
    "to_coco",
    "to_cvat",
    "to_motchallenge",
    "to_movement",
    "to_supervision",
    "to_video",
]
