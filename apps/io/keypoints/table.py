"""Points of persons of a whole film, as they were read from files."""

from collections.abc import Collection, Hashable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame
from ....models.core.keypoints import POINTS, GivenKeypoints
from ....models.core.short_repr import short_repr
from ..point_files import FARTHEST

Array = NDArray[np.float64]

NORMALISED = 2.0
"""px: no film is so small; places that are all below it are shares of the picture."""


@short_repr
@dataclass(frozen=True, eq=False)
class Keypoints:
    """Points of the persons in a film, sorted by frame; called with a frame, those of it.

    Parameters
    ----------
    path
        of the file, or of the folder.
    frame
        `(n,)` int64 of n persons: numbers of frames, 1-based, ascending.
    given
        points of all n.
    place
        `(n,)`: where each stands, for messages.
    """

    path: Path
    frame: NDArray[np.int64]
    given: GivenKeypoints
    place: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.frame)

    def at(self, number: int) -> GivenKeypoints | None:
        """The persons of frame `number`; `None` where the detector did not run, or found nobody."""
        rows = slice(*np.searchsorted(self.frame, [number, number + 1]))
        if rows.start == rows.stop:
            return None
        return GivenKeypoints(self.given.positions[rows], self.given.scores[rows])

    def __call__(self, frame: Frame) -> GivenKeypoints | None:
        """The persons of a frame, by its number."""
        return self.at(frame.number)

    def frames(self) -> Iterator[tuple[int, GivenKeypoints]]:
        """Numbers of the frames in which somebody was found, and who."""
        for number in np.unique(self.frame).tolist():
            given = self.at(number)
            assert given is not None
            yield number, given

    def counted(self, numbers: Collection[int]) -> dict[str, int]:
        """How many persons there are in the frames of these numbers, and in how many of them."""
        taken = self.frame[np.isin(self.frame, list(numbers))]
        return {"persons": len(taken), "frames": len(np.unique(taken))}

    def check(self, film: str, size: tuple[int, int], last: int | None) -> None:
        """Make sure that the points can be of a film.

        Parameters
        ----------
        film
            its name.
        size
            `(width, height)` px.
        last
            number of its last frame; `None` if that is not known.

        Raises
        ------
        ValueError
            if a frame comes after the last one, or nothing of a person lies in the picture.
        """
        if last is not None and len(self) and self.frame[-1] > last:
            first = int(np.searchsorted(self.frame, last + 1))
            raise ValueError(
                f"{self.path}, {self.place[first]}: got frame {self.frame[first]}, "
                f"but {film} has {last} frames"
            )
        places = self.given.positions
        if np.nanmax(np.abs(places), initial=0.0) < NORMALISED < max(size):
            raise ValueError(f"{self.path}: got places from 0 to 1, expected px")
        beyond = np.maximum(-0.5 - places, places - (np.array(size) - 0.5)).max(axis=2)  # NaN: not found
        outside = np.flatnonzero(~(beyond <= 0).any(axis=1))
        if outside.size:
            who = int(outside[0])
            raise ValueError(
                f"{self.path}, {self.place[who]}: got a person in frame {self.frame[who]} of whom nothing "
                f"is in the picture of {size[0]}x{size[1]} px"
            )


@dataclass(eq=False)
class Persons:
    """Persons of a file, gathered point by point and checked.

    Parameters
    ----------
    path
        of the file.
    """

    path: Path
    _rows: dict[tuple[int, Hashable], int] = field(default_factory=dict)
    _points: list[Array] = field(default_factory=list)
    _places: list[str] = field(default_factory=list)

    def of(self, frame: int, person: Hashable, place: str) -> Array:
        """`(15, 3)`: x, y and score of the `POINTS` of somebody in a frame, to be written; NaN so far."""
        row = self._rows.setdefault((frame, person), len(self._points))
        if row == len(self._points):
            self._points.append(np.full((len(POINTS), 3), np.nan))
            self._places.append(place)
        return self._points[row]

    def write(self, points: Array, name: str, numbers: tuple[float, float, float], place: str) -> None:
        """Write a point of a person, if it is one of `POINTS`.

        Raises
        ------
        ValueError
            naming the place, if the numbers are none of a point.
        """
        x, y, score = numbers
        if not (abs(x) <= FARTHEST and abs(y) <= FARTHEST):
            raise self.wrong(place, f"{name} at {x:g}, {y:g}", f"px up to {FARTHEST:g}")
        if not abs(score) < np.inf:
            raise self.wrong(place, f"a score of {score:g}", "a finite one")
        if name in POINTS:
            points[POINTS.index(name)] = numbers

    def wrong(self, place: str, got: str, expected: str) -> ValueError:
        """What to raise for something wrong at a place."""
        return ValueError(f"{self.path}, {place}: got {got}, expected {expected}")

    def table(self) -> Keypoints:
        """All of it, sorted by frame; of whom nothing was found that counts, nothing is kept.

        Raises
        ------
        ValueError
            if that is nobody.
        """
        points = np.array(self._points, np.float64).reshape(-1, len(POINTS), 3)
        given = GivenKeypoints.named(points)
        frame = np.array([number for number, _ in self._rows], np.int64)
        order = np.argsort(frame, kind="stable")
        order = order[(given.scores[order] > 0).any(axis=1)]
        if not len(order):
            raise ValueError(f"{self.path}: holds no point of an upper body")
        kept = GivenKeypoints(given.positions[order], given.scores[order])
        return Keypoints(self.path, frame[order], kept, tuple(self._places[row] for row in order))
