"""Trajectories of objects as a batch chain: who was where in every frame of a film, given all of it.

Of objects j with feet x_j and sizes w_j, in units of their own height:

    p(x_t | x_t-1), p(w_t | w_t-1): constant velocity but for white acceleration
    p(b_t | x_t, w_t) = N(b_t; (x_t, w_t), what the tracker says of its errors)
    mu_{trajectories -> boxes}(b_j) = N(b_j; smoothed box, its variance)

A tracker says where its blobs are as frames come. This chain knows what came after: it smooths every track
both ways, joins tracks over gaps into one identity (all at once, as an assignment), begins each one with the
first frame in which it was seen, and leaves out what was not seen for long enough to be believed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import BatchIncoming, Port, Smoothed
from ...models.core.short_repr import short_repr
from ...models.objects.box_detector import FOOT_Y, HEIGHT, WIDTH
from ...models.objects.box_message import BoxMessage
from ...models.objects.object_boxes import ObjectBoxes
from .blobs import Track, middle_covariance
from .trajectories import Boxes, Comings, Motion, Smooth, joined, joins, messages_of, smoothed


@short_repr
@dataclass(frozen=True, eq=False)
class ObjectsOverTime:
    """Who was where, in every frame.

    Parameters
    ----------
    boxes
        of all objects in all frames, with one identity for each object; `n` in all.
    velocities
        `(n, 2)` px/s of their feet, to the right and down.
    seen
        `(n,)` bool: whether the frame shows them; in gaps they are known from before and after.
    """

    boxes: Boxes
    velocities: NDArray[np.float64]
    seen: NDArray[np.bool_]

    @classmethod
    def of(cls, tracks: Sequence[Smooth]) -> Self:
        """Those of objects that are known, of tracks ordered by identity."""
        known = [track.known() for track in tracks]
        return cls(
            Boxes.together([track.boxes()[rows] for track, rows in zip(tracks, known, strict=True)]),
            np.concatenate(
                [np.zeros((0, 2)), *(t.feet.mean[rows, 2:] for t, rows in zip(tracks, known, strict=True))]
            ),
            np.concatenate(
                [np.zeros(0, bool), *(t.seen[rows] for t, rows in zip(tracks, known, strict=True))]
            ),
        )

    def at(self, index: int) -> list[Track]:
        """Every object in a frame, by index from 0; of who is reported here, nobody is unsure any more."""
        rows = np.flatnonzero(self.boxes.frames == index)
        boxes = self.boxes[rows]
        corners = boxes.means - np.outer(boxes.means[:, WIDTH], [0.5, 0, 0, 0])
        corners[:, FOOT_Y] -= boxes.means[:, HEIGHT]
        return [
            Track(identity, (x, y, width, height), 1.0, (vx, vy), seen, middle_covariance(variance))
            for identity, (x, y, width, height), (vx, vy), seen, variance in zip(
                boxes.identities.tolist(),
                corners.tolist(),
                self.velocities[rows].tolist(),
                self.seen[rows].tolist(),
                boxes.variances,
                strict=True,
            )
        ]

    @property
    def log_prior(self) -> float:
        """0: what the dynamics cost is part of the smoothing."""
        return 0.0


@short_repr
@dataclass(frozen=True)
class ObjectTrajectories:
    """Batch chain over the boxes of objects.

    Parameters
    ----------
    acceleration
        heights/s^2, standard deviation of what moves a foot out of its straight way; it lasts half a second.
    growth
        heights/s^2, the same of a width or height.
    first_speed
        heights/s, standard deviation of a velocity.
    patience
        s, for which somebody may be out of sight and still be the same.
    least_seen
        s for which an object must have been seen in all.
    """

    acceleration: float = 0.9
    growth: float = 0.5
    first_speed: float = 1.0
    patience: float = 3.0
    least_seen: float = 0.35
    name: str = "trajectories"

    ports = (Port(ObjectBoxes),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: ObjectsOverTime | None = None
    ) -> Smoothed[ObjectsOverTime]:
        """Trajectories given what others say of boxes in all frames."""
        size = next(
            (each.frame.image.shape[:2] for each in incoming_over_time if each.frame.image is not None),
            (1, 1),
        )
        times = np.array([each.time for each in incoming_over_time])
        boxes = Boxes.of(each.others(ObjectBoxes).objects for each in incoming_over_time)
        motion = Motion(0.5 * self.acceleration**2, 0.5 * self.growth**2, self.first_speed)
        interval = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        tracks = [smoothed(track, times, motion) for track in boxes.tracks()]
        known = [track for track in tracks if track.seen.sum() * interval >= self.least_seen]
        comings = Comings(size, len(known) / max(times[-1] - times[0], 1.0), self.patience)
        next_of = joins(known, times, motion, comings)
        together = joined(boxes, known, next_of).tracks()
        return Smoothed(ObjectsOverTime.of([smoothed(track, times, motion) for track in together]))

    def messages(
        self,
        trajectory: ObjectsOverTime,
        feature: ObjectBoxes,
        incoming_over_time: Sequence[BatchIncoming],
    ) -> list[BoxMessage]:
        """Where every object is in each frame (mu_{trajectories -> boxes})."""
        return messages_of(trajectory.boxes, len(incoming_over_time))
