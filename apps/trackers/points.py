"""Tracker of points, given one image after the other."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ...chains.points import point_tracker
from ...chains.structure.recursive_structure import RecursiveStructure
from ...inference import MultiChain, RecursiveBP
from ...models.core.checks import Count, Positive, Shape, checked
from ...models.core.frame import GivenPoints
from ...models.points.point_tracks import PointTracks
from .tracker import Floats, Picture, Tracker


@dataclass(frozen=True, eq=False)
class Points:
    """Points in an image, by increasing identity.

    Parameters
    ----------
    positions, covariances
        `(n, 2)` px and `(n, 2, 2)` px^2.
    velocities
        `(n, 2)` px/s.
    identities
        `(n,)` from 1, unless they were given: constant for each point, never used twice.
    seen
        `(n,)`: whether the image shows the point; otherwise it is only predicted.
    """

    positions: Floats
    covariances: Floats
    velocities: Floats
    identities: NDArray[np.int64]
    seen: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.identities)


class PointTracker(Tracker[None, Points]):
    """Tracker of corners, as `rsmcm structure --engine recursive-bp`.

    Parameters
    ----------
    rigid
        whether the points belong to one rigid object: its learned shape then predicts hidden points, so that
        they are found again under their identity.
    points
        number of points.
    frame_rate
        images per second, if `update` gets no time.
    """

    @checked
    def __init__(self, rigid: bool = True, points: Count = 200, frame_rate: Positive = 25.0) -> None:
        self._tracker = point_tracker.PointTracker(n_points=points)
        node = PointTracks()
        model = MultiChain().connect(self._tracker, node)
        self._points = RecursiveBP(model.connect(RecursiveStructure(), node) if rigid else model)
        super().__init__(frame_rate, rigid=rigid, points=points)

    @checked
    def update(
        self,
        image: Picture | None,
        positions: Annotated[Any, Shape("n", 2)] | None = None,
        identities: Annotated[Any, Shape("n")] | None = None,
        time: float | None = None,
    ) -> Points:
        """Return the points in the next image.

        Parameters
        ----------
        image
            uint8, BGR or grey; `None` if it is missing.
        positions, identities
            `(n, 2)` px and `(n,)`, increasing: points of another tracker, instead of points of the image.
        time
            s, later than that of the last image.

        Raises
        ------
        TypeError, ValueError
            if an argument has a wrong type, shape or range.
        """
        if (positions is None) != (identities is None):
            raise ValueError("positions: got them or identities alone, expected both or neither")
        given = None
        if positions is not None:
            given = GivenPoints(np.array(positions, np.float64), np.array(identities, np.int64))
        belief = self._step(self._frame(image, time, points=given))
        if not belief.states:
            nothing = np.zeros((0, 2))
            return Points(nothing, np.zeros((0, 2, 2)), nothing, np.zeros(0, np.int64), np.zeros(0, bool))
        known = belief[self._tracker].known
        followed = known.only(known.alive)
        states = followed.states
        return Points(
            states.position,
            states.position_covariance,
            states.mean[:, 2:],
            followed.identities,
            followed.unseen == 0,
        )

    def _build(self, start: None) -> RecursiveBP:
        return self._points

    def _chains(self) -> Mapping[str, Any]:
        return self._points.model.chains
