"""A film of a few frames with masks and boxes, and what is read of its results."""

from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.background.page import view_row_of
from rsmcm.apps.io.files import PART
from rsmcm.apps.io.tracks import TrackedBox
from rsmcm.apps.view.overlay import OverlayVideo, TracksOverlay
from rsmcm.models.core.frame import Frame

HEIGHT, WIDTH = 49, 63  # odd on purpose


@dataclass(frozen=True)
class Box:
    identity: int
    box: tuple[float, float, float, float]
    confidence: float


def mask(number: int) -> NDArray[np.uint8]:
    return np.where(np.random.default_rng(number).random((HEIGHT, WIDTH)) < 0.3, 255, 0).astype(np.uint8)


def frame(number: int) -> Frame:
    image = np.full((HEIGHT, WIDTH, 3), 20 + 5 * number, np.uint8)
    return Frame(image, (number - 1) / 10, number)


def boxes(number: int) -> list[Box]:
    return [Box(3, (number, 10.25, 8.5, 20), 0.75), Box(11, (30 - number, 5, 10, 12), 1.0)]


def read_video(path: Path) -> tuple[list[NDArray[np.uint8]], list[float]]:
    with av.open(str(path)) as file:
        form = "gray" if path.suffix == ".mkv" else "bgr24"
        frames = list(file.decode(video=0))
        pictures = [np.asarray(one.to_ndarray(format=form), dtype=np.uint8) for one in frames]
        return pictures, [one.time for one in frames]


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def joined_names(folder: Path) -> set[str]:
    """Without those of segments."""
    return {name for name in names(folder) if PART not in name}


def overlay_of(path: Path, resume_after: int = 0) -> OverlayVideo:
    return OverlayVideo(path, 10, TracksOverlay(), resume_after)


def add(video: OverlayVideo, number: int) -> None:
    """Append a frame with its mask and boxes."""
    tracks = [TrackedBox(each.identity, each.box, each.confidence) for each in boxes(number)]
    video.add(frame(number), lambda: view_row_of(mask(number), tracks))


def write_overlay(path: Path, first: int, last: int, every: int, resume_after: int = 0) -> None:
    with overlay_of(path, resume_after) as video:
        for number in range(first, last + 1):
            add(video, number)
            if number % every == 0:
                video.checkpoint()
