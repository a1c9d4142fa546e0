"""Evaluation of body trackers: errors, calibration of the posterior, mis-tracks and recovery."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import JOINTS
from ..view.overlay import REGION_90, TrackedBody

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MEASURED = ("left_elbow", "left_hand", "right_elbow", "right_hand")
PLACES = [JOINTS.index(name) for name in MEASURED]
ELBOWS, HANDS = (slice(first, None, 2) for first in (0, 1))

OFF, RECOVERED = 0.5, 0.3  # head heights: error from which a hand is lost, and below which it is recovered
LEAST_OFF = 2  # consecutive frames of a mis-track, at least
SOON = 10  # frames within which a visible hand should be recovered
LEAST_VARIANCE = 0.01  # px^2: added to a hand's covariance, since all samples may coincide
APART = 0.5  # head heights: true hands that are nearer to each other are not told apart


@dataclass(frozen=True)
class MisTrack:
    """A hand (0 left, 1 right) that was lost for a while.

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
        """Whether it was recovered soon after it became visible; `None` if the scene ended before."""
        if self.end is not None:
            return self.seen is None or self.end - self.seen <= SOON
        return False if self.left > SOON else None


@dataclass(frozen=True, eq=False)
class BodyTrial:
    """Results of a tracker on a scene; the first frame, whose pose is given, does not count.

    Parameters
    ----------
    errors, errors_3d
        `(n_frames, 4)` px: distance in the picture, and in space, of the posterior mean of the joints
        `MEASURED` from the truth; NaN of joints that are not tracked.
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
        the same of smoothed poses; `None` without smoothing.
    """

    errors: Array
    errors_3d: Array
    nees: Array
    effective: Array
    seconds: Array
    hidden: Mask
    exchanged: Array
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
        """Share of frames in which a hand is lost."""
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


def mis_tracks(hand: int, errors: Array, hidden: Mask) -> list[MisTrack]:
    """Return the mis-tracks of a hand, from its errors `(n_frames,)` in head heights.

    One ends where the error is below 0.3 head heights.
    """
    tracks: list[MisTrack] = []
    n_frames, index = len(errors), 1
    while index < n_frames:
        ahead = errors[index : index + LEAST_OFF]
        if len(ahead) < LEAST_OFF or not (ahead > OFF).all():
            index += 1
            continue
        end = _first(errors < RECOVERED, index)
        seen = _first(~hidden, index)
        left = 0 if seen is None else n_frames - 1 - seen
        tracks.append(MisTrack(hand, index, seen, end, left))
        index = n_frames if end is None else end
    return tracks


def _first(holds: Mask, start: int) -> int | None:
    """Return the first index from `start` on where it holds."""
    ahead = np.flatnonzero(holds[start:])
    return start + int(ahead[0]) if len(ahead) else None


def exchanged_hands(hands: Array, truth: Array, apart: float) -> Array:
    """Return whether each hand is nearer to the other one's true position: `(n,)`, 1, 0, or NaN.

    Parameters
    ----------
    hands, truth
        `(n, 2, 2)` px: of left and right hand in n frames; NaN where a place is not known.
    apart
        px: NaN where the true hands are nearer to each other.
    """
    own, other = (np.linalg.norm(hands - places, axis=2) for places in (truth, truth[:, ::-1]))
    clear = np.linalg.norm(truth[:, 0] - truth[:, 1], axis=1) >= apart
    clear &= np.isfinite(own).all(axis=1)
    return np.where(clear, (other < own).all(axis=1), np.nan)


def longest_exchange(numbers: NDArray[np.int64], exchanged: Array) -> int:
    """Return the number of frames of the longest stretch with exchanged hands.

    `numbers (n,)` are those of the frames, in order; NaN of `exchanged (n,)`, as of `exchanged_hands`, does
    not end a stretch.
    """
    clear = np.isfinite(exchanged)
    longest, first = 0, None
    for number, so in zip(numbers[clear].tolist(), exchanged[clear] > 0, strict=True):
        first = (number if first is None else first) if so else None
        if first is not None:
            longest = max(longest, number - first + 1)
    return longest


def pooled(trials: Sequence[BodyTrial], measure: str) -> Array:
    """Return a measure of every frame after the first, of all scenes: `(n, ...)`."""
    return np.concatenate([getattr(trial, measure)[1:] for trial in trials])


def coverage(trials: Sequence[BodyTrial]) -> float:
    """Return the share of true hands within the posterior's 90 % region."""
    return float((pooled(trials, "nees") < REGION_90).mean())


def recoveries(trials: Sequence[BodyTrial]) -> tuple[int, int]:
    """Return the number of mis-tracks with a soon recovery, and of all for which it is known."""
    known = [one.recovered for trial in trials for one in trial.mis_tracks if one.recovered is not None]
    return sum(known), len(known)
