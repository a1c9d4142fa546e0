"""Faults of the detectors of a signer: features that are missing for a while, and false skin."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

MISSING = (2, 12)  # frames that a feature is missing in one burst
FALSE = (4, 20)  # frames that false skin is there
FACE_BOX = 0.75  # side of a detected face's box, in head heights; brow to chin
FACE_BELOW = 0.1  # sides: how much lower the middle of the box is than the head's
BOX_NOISE = 0.03  # of place and side of a box, in its side


@dataclass(frozen=True, eq=False)
class Distractor:
    """A false hand: skin-coloured, about as large as a hand."""

    first: int  # index of the first frame in which it is there, from 0
    last: int  # index of the last one
    start: Array  # `(2,)` px in frame `first`
    velocity: Array  # `(2,)` px a frame
    radius: float  # px
    in_front: bool  # whether it is before the trunk, or behind everything
    seed: int  # of its shape and tone

    def place(self, index: float) -> Array:
        """`(2,)` px: its centre in frame `index`."""
        centre: Array = self.start + (index - self.first) * self.velocity
        return centre


@dataclass(frozen=True, eq=False)
class ListedFaces:
    """A face detector that returns `boxes[k]` for frame k + 1."""

    boxes: tuple[Array, ...]

    def __call__(self, frame: Frame) -> Array:
        """Return boxes x, y, width, height, `(k, 4)` px; none for a frame without an image.

        Raises
        ------
        ValueError
            if the frame's number is beyond the list.
        """
        if frame.number > len(self.boxes):
            raise ValueError(
                f"detector: got frame {frame.number}, expected one of its own scene, 1 to {len(self.boxes)}"
            )
        return np.empty((0, 4)) if frame.image is None else self.boxes[frame.number - 1].copy()


def bursts(n_frames: int, share: float, lengths: tuple[int, int], generator: np.random.Generator) -> Counts:
    """Draw bursts: `(n_frames,)` numbers of bursts, from 1, or 0; `share` of frames are in one.

    The length of a burst is uniform in a range. Pauses are half to one and a half times their mean, so that a
    short scene, too, has nearly its share. A scene begins with a pause.
    """
    numbers = np.zeros(n_frames, np.int64)
    if share <= 0:
        return numbers
    pause = 0.5 * sum(lengths) * (1 - share) / share
    now, number = generator.uniform(0, 1) * pause, 0
    while now < n_frames:
        number += 1
        length = int(generator.integers(lengths[0], lengths[1] + 1))
        start = round(now)
        numbers[start : start + length] = number
        now += length + generator.uniform(0.5, 1.5) * pause
    return numbers


def false_skin(
    bodies: Array, head_height: float, size: tuple[int, int], amount: float, seed: int
) -> tuple[Distractor, ...]:
    """Draw false skin about `bodies` `(n_frames, 2)` px, the points between the shoulders.

    About 15 % of the frames have one or two if `amount` is 1.
    """
    generator = np.random.default_rng([seed, 21])
    numbers = bursts(len(bodies), min(0.15 * amount, 1.0), FALSE, generator)
    distractors = []
    for number in range(1, int(numbers.max(initial=0)) + 1):
        when = np.flatnonzero(numbers == number)
        if not len(when):
            continue
        for _ in range(int(generator.integers(1, 3))):
            away = generator.uniform((-2.2, -1.2), (2.2, 2.0)) * head_height
            speed = generator.exponential(0.02) * head_height * (generator.random() < 0.6)
            angle = generator.uniform(0, 2 * np.pi)
            radius = head_height * generator.uniform(0.17, 0.28)
            start = np.clip(bodies[when[0]] + away, radius, np.array(size) - 1 - radius)
            distractors.append(
                Distractor(
                    int(when[0]),
                    int(when[-1]),
                    start,
                    speed * np.array([np.cos(angle), np.sin(angle)]),
                    radius,
                    bool(generator.random() < 0.4),
                    int(generator.integers(2**31)),
                )
            )
    return tuple(distractors)


def face_boxes(
    heads: Array,
    missed: NDArray[np.bool_],
    head_height: float,
    size: tuple[int, int],
    clutter: float,
    seed: int,
) -> ListedFaces:
    """Draw boxes of faces about `heads` `(n_frames, 2)` px, except where `missed`, and false alarms."""
    generator = np.random.default_rng([seed, 22])
    boxes = []
    for head, gone in zip(heads, missed, strict=True):
        side = FACE_BOX * head_height
        errors = BOX_NOISE * side * generator.standard_normal(3)
        middle = head + np.array([0.0, FACE_BELOW * side]) + errors[:2]
        true = _box(middle, side + errors[2])
        n_false = int(generator.poisson(0.04 * clutter))
        centres = generator.uniform(0, 1, (n_false, 2)) * size
        sides = side * generator.uniform(0.5, 1.3, n_false)
        false = [_box(centre, false_side) for centre, false_side in zip(centres, sides, strict=True)]
        boxes.append(np.array(false if gone else [true, *false]).reshape(-1, 4))
    return ListedFaces(tuple(boxes))


def _box(centre: Array, side: float) -> Array:
    return np.array([*(centre - side / 2), side, side])
