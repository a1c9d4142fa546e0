"""Which of the faces that a detector finds in several pictures are one person's, and where others' are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr

Array = NDArray[np.float64]

ALIKE = 1.4
"""Of two faces of one person, the higher one is at most so many times as high."""

APART = 2.0
"""Face heights that a person has moved at most from one picture to the next: of one who moves farther less is
learned."""

SWAY = 0.5
"""Face heights: standard deviation of faces about the places where they were seen."""


@short_repr
@dataclass(frozen=True, eq=False)
class OtherFaces:
    """Where faces of others are seen: to the person who is tracked, they are false ones that stay.

    Parameters
    ----------
    places
        `(m, 2)` px: middles of all others' faces in some pictures.
    pictures
        how many.
    spread
        px: standard deviation about these.
    """

    places: Array
    pictures: int
    spread: float

    @classmethod
    def learned(cls, found: Sequence[Array], own: Sequence[int | None]) -> Self:
        """From the faces `(k, 4)` px of some pictures, of those in which the person's own one is found, too:
        anywhere else, a face may be the person's.
        """
        seen = [(boxes, one) for boxes, one in zip(found, own, strict=True) if one is not None]
        rest = np.concatenate([np.delete(boxes, one, axis=0) for boxes, one in seen])
        height = np.median([boxes[one, 3] for boxes, one in seen])
        return cls(rest[:, :2] + 0.5 * rest[:, 2:], len(seen), float(SWAY * height))

    def density(self, places: Array) -> Array:
        """`(n,)` expected faces of others a px^2 and picture at places `(n, 2)` px."""
        squares = ((places[:, None] - self.places) ** 2).sum(axis=2) / self.spread**2
        total = np.exp(-0.5 * squares).sum(axis=1)
        return np.asarray(total / (2 * np.pi * self.spread**2 * self.pictures), np.float64)


def one_person(found: Sequence[Array], start: tuple[int, int]) -> list[int | None]:
    """Number of a person's face in every picture, `None` where it has none.

    From one picture to the next, it is the nearest face of about the same size that is not too far, first on
    to the last picture, then back to the first.

    Parameters
    ----------
    found
        by picture, `(k, 4)` px: boxes x, y, width, height; k may be 0.
    start
        picture and face to begin with.
    """
    chosen: list[int | None] = [None] * len(found)
    first, face = start
    chosen[first] = face
    for order in (range(first + 1, len(found)), range(first - 1, -1, -1)):
        last = found[first][face]
        for picture in order:
            chosen[picture] = _nearest(found[picture], last)
            if chosen[picture] is not None:
                last = found[picture][chosen[picture]]
    return chosen


def largest_face(found: Sequence[Array]) -> tuple[int, int]:
    """Picture and number of the face with which the person that is seen largest begins.

    Of the largest faces of all pictures it is the one of median height: a false one may be higher.

    Raises
    ------
    ValueError
        if there is no face.
    """
    largest = [
        (float(boxes[:, 3].max()), picture, int(boxes[:, 3].argmax()))
        for picture, boxes in enumerate(found)
        if len(boxes)
    ]
    if not largest:
        raise ValueError(f"found: got no face in {len(found)} pictures, expected one at least")
    _, picture, face = sorted(largest)[len(largest) // 2]
    return picture, face


def face_at(found: Sequence[Array], box: Array) -> tuple[int, int]:
    """Picture and number of the face that is nearest to a box `(4,)` px, in the first picture with any.

    Raises
    ------
    ValueError
        if there is no face.
    """
    for picture, boxes in enumerate(found):
        if len(boxes):
            return picture, int(_distances(boxes, box).argmin())
    raise ValueError(f"found: got no face in {len(found)} pictures, expected one at least")


def _nearest(boxes: Array, last: Array) -> int | None:
    distances = _distances(boxes, last)
    alike = np.abs(np.log(boxes[:, 3] / last[3])) < np.log(ALIKE)
    alike &= distances < APART * last[3]
    return int(np.where(alike, distances, np.inf).argmin()) if alike.any() else None


def _distances(boxes: Array, box: Array) -> Array:
    """`(k,)` px between middles."""
    steps = boxes[:, :2] + 0.5 * boxes[:, 2:] - box[:2] - 0.5 * box[2:]
    return np.asarray(np.linalg.norm(steps, axis=1), np.float64)
