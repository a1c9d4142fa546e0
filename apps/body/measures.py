"""How well a body was followed: errors, calibration of the posterior, mis-tracks and recovery from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import JOINTS
from ..view.overlay import REGION_90, TrackedBody

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]

MEASURED = ("left_elbow", "left_hand", "right_elbow", "right_hand")
PLACES = [JOINTS.index(name) for name in MEASURED]
ELBOWS, HANDS = (slice(first, None, 2) for first in (0, 1))

OFF, FOUND = 0.5, 0.3
"""Head heights: error from which a hand is not followed, and below which it is followed again."""
LEAST_OFF = 2
"""Frames in a row that make a mis-track."""
SOON = 10
"""Frames after which a hand should be followed again, from the first in which it can be seen."""

LEAST_VARIANCE = 0.01
"""px^2: added to a hand's covariance, since all samples may be one."""

APART = 0.5
"""Head heights: of true hands that are nearer to each other nobody can say which one was found."""


@dataclass(frozen=True)
class MisTrack:
    """A hand (0 left, 1 right) that was not followed for a while.

    Parameters
    ----------
    start
        first frame with the error above half a head's height, index from 0.
    seen
        first frame from then on in which the hand looks like skin; `None` if there is none.
    end
        first frame from `start` on with the error below 0.3 head heights; `None` if there is none.
    left
        frames from `seen` to the end of the scene.
    """

    hand: int
    start: int
    seen: int | None
    end: int | None
    left: int

    @property
    def recovered(self) -> bool | None:
        """Whether it was followed again soon after it could be seen; `None` where the scene ended before."""
        if self.end is not None:
            return self.seen is None or self.end - self.seen <= SOON
        return False if self.left > SOON else None


@dataclass(frozen=True, eq=False)
class BodyTrial:
    """How a tracker did on a scene; of the first frame, in which the pose is given, nothing counts.

    Parameters
    ----------
    errors, errors_3d
        `(n_frames, 4)` px: distance in the picture, and in space, of the posterior mean of the joints
        `MEASURED` from the truth; NaN of joints that the tracker knows nothing of.
    nees
        `(n_frames, 2)`: squared Mahalanobis distance of left and right hand in the picture, with the
        posterior's mean and covariance.
    effective
        `(n_frames,)`: effective number of samples; NaN without samples.
    seconds
        `(n_frames,)`: of the whole frame, features included.
    hidden
        `(n_frames, 2)`: whether left and right hand do not look like skin.
    exchanged
        `(n_frames,)`: whether the hands are exchanged, as of `exchanged_hands`.
    head_height
        px.
    shown
        by frame (index from 0), the posterior in pictures.
    later
        the same of answers with hindsight; `None` without.
    """

    errors: Numbers
    errors_3d: Numbers
    nees: Numbers
    effective: Numbers
    seconds: Numbers
    hidden: Mask
    exchanged: Numbers
    head_height: float
    shown: Mapping[int, TrackedBody] = field(default_factory=dict)
    later: "BodyTrial | None" = None

    @property
    def error(self) -> float:
        """px: mean over hands and elbows."""
        return float(self.errors[1:].mean())

    @property
    def hands(self) -> float:
        """px: mean over the hands."""
        return float(self.errors[1:, HANDS].mean())

    @property
    def off(self) -> float:
        """Share of frames in which a hand is not followed."""
        far = self.errors[1:, HANDS] > OFF * self.head_height
        return float(far.any(axis=1).mean())

    @property
    def longest_exchange(self) -> int:
        """Frames of the longest stretch in which the hands are exchanged."""
        return longest_exchange(np.arange(len(self.exchanged)), self.exchanged)

    @cached_property
    def mis_tracks(self) -> list[MisTrack]:
        """Of both hands, in the order of time for each."""
        heads = self.errors[:, HANDS] / self.head_height
        return [one for hand in (0, 1) for one in mis_tracks(hand, heads[:, hand], self.hidden[:, hand])]


def mis_tracks(hand: int, errors: Numbers, hidden: Mask) -> list[MisTrack]:
    """Mis-tracks of a hand, from its errors `(n_frames,)` in head heights after the first frame.

    One ends where the error is below 0.3 head heights, whatever it was in between.
    """
    found: list[MisTrack] = []
    n_frames, index = len(errors), 1
    while index < n_frames:
        ahead = errors[index : index + LEAST_OFF]
        if len(ahead) < LEAST_OFF or not (ahead > OFF).all():
            index += 1
            continue
        end = _first(errors < FOUND, index)
        seen = _first(~hidden, index)
        left = 0 if seen is None else n_frames - 1 - seen
        found.append(MisTrack(hand, index, seen, end, left))
        index = n_frames if end is None else end
    return found


def _first(holds: Mask, start: int) -> int | None:
    """First index from `start` on where it holds."""
    ahead = np.flatnonzero(holds[start:])
    return start + int(ahead[0]) if len(ahead) else None


def exchanged_hands(hands: Numbers, truth: Numbers, apart: float) -> Numbers:
    """Whether each hand is nearer to where the other one truly is: `(n,)`, 1 or 0, NaN where nobody can say.

    Parameters
    ----------
    hands, truth
        `(n, 2, 2)` px: of left and right hand in n frames; NaN where a place is not known.
    apart
        px: true hands that are nearer to each other do not tell.
    """
    own, other = (np.linalg.norm(hands - places, axis=2) for places in (truth, truth[:, ::-1]))
    told = np.linalg.norm(truth[:, 0] - truth[:, 1], axis=1) >= apart
    told &= np.isfinite(own).all(axis=1)
    return np.where(told, (other < own).all(axis=1), np.nan)


def longest_exchange(numbers: NDArray[np.int64], exchanged: Numbers) -> int:
    """Frames from the first to the last of the longest stretch with exchanged hands.

    `numbers (n,)` are those of the frames, in order; where `exchanged (n,)`, as of `exchanged_hands`, is NaN,
    nobody can say, and a stretch does not end.
    """
    told = np.isfinite(exchanged)
    longest, first = 0, None
    for number, so in zip(numbers[told].tolist(), exchanged[told] > 0, strict=True):
        first = (number if first is None else first) if so else None
        if first is not None:
            longest = max(longest, number - first + 1)
    return longest


def pooled(trials: Sequence[BodyTrial], measure: str) -> Numbers:
    """A measure of every frame after the first, of all scenes: `(n, ...)`."""
    return np.concatenate([getattr(trial, measure)[1:] for trial in trials])


def coverage(trials: Sequence[BodyTrial]) -> float:
    """Share of the true hands that are within the posterior's 90 % region."""
    return float((pooled(trials, "nees") < REGION_90).mean())


def recoveries(trials: Sequence[BodyTrial]) -> tuple[int, int]:
    """Mis-tracks after which the hand was followed again soon, and all of which it is known."""
    known = [one.recovered for trial in trials for one in trial.mis_tracks if one.recovered is not None]
    return sum(known), len(known)
