"""Objects as `supervision` takes them, to draw, count and filter."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Shape, checked
from ..io.tracks import TrackedObject
from ..options.libraries import needed
from .coco import object_masks

if TYPE_CHECKING:
    import supervision


@checked
def to_supervision(
    tracks: Sequence[TrackedObject], foreground: Annotated[NDArray[np.uint8], Shape(None, None)] | None = None
) -> "supervision.Detections":
    """Return objects of a frame as `supervision.Detections`.

    Parameters
    ----------
    tracks
        as a belief has them, `belief["blobs"].tracks()`, or a frame of `FinishedRun.frames`.
    foreground
        `(height, width)`, 0 or 255; what of it lies in an object's box becomes its mask.

    Returns
    -------
    supervision.Detections
        `xyxy` px, from the left edge of the first pixel (0) to the right edge of the last one (the width);
        `confidence`, `tracker_id`, `class_id` 0; `mask` if `foreground` is given; and `data`: `velocity` `(n,
        2)` px/s, `seen` `(n,)` bool, and `covariance` `(n, 2, 2)` px^2 of the middles of boxes, NaN of a
        finished run, which does not store it.

    Raises
    ------
    ImportError
        if `supervision` is not installed.
    """
    boxes = np.array([track.box for track in tracks], np.float64).reshape(-1, 4)
    detections: supervision.Detections = needed("supervision").Detections(
        xyxy=np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]]),
        mask=None if foreground is None else object_masks(foreground, boxes),
        confidence=np.array([track.confidence for track in tracks], np.float64),
        class_id=np.zeros(len(tracks), np.int64),
        tracker_id=np.array([track.identity for track in tracks], np.int64),
        data={
            "velocity": np.array([track.velocity for track in tracks], np.float64).reshape(-1, 2),
            "seen": np.array([track.seen for track in tracks], bool),
            "covariance": np.array([track.position_covariance for track in tracks]).reshape(-1, 2, 2),
        },
    )
    return detections
