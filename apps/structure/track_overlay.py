"""Tracks of points, drawn on the frames that they were found in."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..drawing.boxes import identity_colour
from ..io.segmented_video import PLAYABLE, SegmentedVideo
from ..runs.progress import Progress
from .reconstruction import Reconstruction

Image = NDArray[np.uint8]

TRAIL_FRAMES = 12
FRACTION_BITS = 4  # of the coordinates that are handed to OpenCV


def draw_points(image: Image, found: Reconstruction, index: int) -> Image:
    """Draw the points of a frame: seen ones as dots with the way that they came, predicted ones as rings.

    Parameters
    ----------
    image
        `(height, width)` or `(height, width, 3)` BGR.
    found
        where the points are.
    index
        of the frame, from 0.

    Returns
    -------
    NDArray[np.uint8]
        `(height, width, 3)` BGR.
    """
    picture: NDArray[Any] = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    height, width = picture.shape[:2]
    unit = max(1.0, height / 480)  # dots and lines grow with the picture
    first = max(0, index - TRAIL_FRAMES)
    seen = found.observed[first : index + 1]
    places = found.positions[first : index + 1] + np.where(
        seen[..., None], found.residuals[first : index + 1], 0
    )
    margin = np.array([width, height])
    near: NDArray[np.bool_] = np.all((places > -margin) & (places < 2 * margin), axis=2)  # NaN is not near
    fixed = np.rint(np.where(near[..., None], places, 0) * (1 << FRACTION_BITS)).astype(np.int32)
    radius = round(2.2 * unit * (1 << FRACTION_BITS))
    for point in range(found.n_points):
        if not near[-1, point]:
            continue
        colour = identity_colour(point)
        centre = (int(fixed[-1, point, 0]), int(fixed[-1, point, 1]))
        if seen[-1, point]:
            trail = fixed[near[:, point] & seen[:, point], point]
            cv2.polylines(picture, [trail], False, colour, max(1, round(unit)), cv2.LINE_AA, FRACTION_BITS)
            cv2.circle(picture, centre, radius, colour, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)
        else:
            cv2.circle(picture, centre, radius, colour, 1, cv2.LINE_AA, FRACTION_BITS)
    return np.asarray(picture, np.uint8)


def write_overlay(path: Path, frames: Sequence[Frame], found: Reconstruction, rate: float) -> None:
    """Write a video of all frames with their points; for a missing frame the one before is shown.

    Raises
    ------
    OSError
        if it cannot be written.
    """
    video = SegmentedVideo(path, rate, PLAYABLE)
    last: Image | None = None
    with Progress("overlay", len(frames)) as progress:
        for index, frame in enumerate(frames):
            last = last if frame.image is None else frame.image
            if last is not None:
                video.write(draw_points(last, found, index), frame.number, frame.time)
            progress.update()
    video.close(finished=True)
