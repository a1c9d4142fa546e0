"""A few pictures of a run of any length."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..drawing.mosaic import fitting
from .evenly_spaced import EvenlySpaced
from .page import picture_grid

Image = NDArray[np.uint8]

MOST_SNAPSHOTS = 8
SNAPSHOT_WIDTH = 480  # px; wider pictures are kept smaller


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A picture of a frame: its number, its time in seconds, `(height, width[, 3])` uint8 BGR."""

    number: int
    time: float
    picture: Image


class Snapshots:
    """At most eight evenly spaced pictures of a run.

    Parameters
    ----------
    width
        px: wider pictures are kept smaller.
    """

    KINDS: ClassVar[dict[str, Any]] = {
        "most": int,
        "kept": tuple[Snapshot, ...],
        "count": int,
        "stride": int,
        "due": int,
    }
    """What `saved` gives, for `rsmcm.inference.engine.checkpoint`."""

    def __init__(self, width: int = SNAPSHOT_WIDTH) -> None:
        self._width = width
        self._kept: EvenlySpaced[Snapshot] = EvenlySpaced(MOST_SNAPSHOTS)

    def __len__(self) -> int:
        return len(self._kept.kept)

    def __iter__(self) -> Iterator[Snapshot]:
        return iter(self._kept.kept)

    def add(self, frame: Frame, draw: Callable[[], Image]) -> None:
        """Take in a frame; `draw` is called for the few of which a picture is kept."""
        self._kept.add(lambda: Snapshot(frame.number, frame.time, small(draw(), self._width)))

    def redraw(self, number: int, draw: Callable[[], Image]) -> None:
        """Have another picture of a frame, if one of it is kept."""
        kept = self._kept.kept
        for index, one in enumerate(kept):
            if one.number == number:
                kept[index] = replace(one, picture=small(draw(), self._width))

    def saved(self) -> dict[str, Any]:
        """Everything."""
        return {**vars(self._kept), "kept": tuple(self._kept.kept)}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Take over what `saved` was."""
        self._kept = EvenlySpaced(**{**saved, "kept": list(saved["kept"])})

    def row(self, name: str) -> Markup:
        """All pictures beside each other in a row of that name."""
        columns = [f"frame {each.number}, {each.time:.1f} s" for each in self]
        return picture_grid([(name, [each.picture for each in self])], columns)

    def column(self) -> Markup:
        """All pictures below each other."""
        rows = [(f"{each.time:.1f} s", [each.picture]) for each in self]
        return picture_grid(rows, [""])


def small(image: Image, most: int = SNAPSHOT_WIDTH) -> Image:
    """A copy that is at most so many px wide, and four times as high."""
    size = fitting(image.shape, most)
    if size[1] >= image.shape[0]:
        return image.copy()
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
