"""Recovery of a doubted or lost object: trust in the track, where to search, detection by a finder."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ...models.core.short_repr import PickledByFields, short_repr
from ...models.face.detectors import PartDetector, for_height
from ...models.face.morphable_model import MorphableModel, Poses
from ...models.numerics.rotations import exponential

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

FARTHEST_AHEAD = 1.5  # share of an expert's last motion, up to which experts begin their search ahead
ASIDE = 0.5  # how far they begin it aside, in standard deviations of the motion
STRAIGHT = 0.25  # share of the experts that do not
STEP = 0.3  # distance between places that are tried for a lost object, in its sizes

SIZES = (0.8, 1.0, 1.25)
TURNS = (-0.35, 0.0, 0.35)  # rad about the upright axis, against the pose that it was last seen in
AT_ONCE = 2000  # poses that are tried at once, which bounds the memory


def apart(poses: Poses, motion: Array, walk: Array, random: np.random.Generator) -> Poses:
    """Poses from which experts begin, so that not all of them take a wrong mode for the right one.

    They go on by different shares of their last motion, and most of them step aside, too. What they believe
    is not touched by it: all climb on the same likelihood and prior, each from a place of its own.

    `poses`: of the experts in the picture before; `motion` `(n, dimension)`: how each would have moved until
    now, had it gone on; `walk` `(dimension,)` variances of the motion; `random`: to draw from; it is moved
    on.
    """
    n, dimension = motion.shape
    share = np.linspace(0.0, FARTHEST_AHEAD, n)[random.permutation(n)]
    aside = ASIDE * np.sqrt(walk) * random.standard_normal((n, dimension))
    aside[random.random(n) < STRAIGHT] = 0.0
    return poses.moved(share[:, None] * motion + aside)


def likely_places(
    misfit: Callable[[Poses], Array], size: tuple[int, int], last: Poses, middle: Array, n: int
) -> Poses:
    """The `n` poses, of a grid of places, sizes and turns, whose coarse texture fits the picture best.

    `misfit`: of poses, `(n,)`, infinite where nothing of them is in the picture; `size` `(height, width)` px
    of the picture; `last`: the pose in which it was seen last, which gives turns and shape; `middle` `(2,)`
    px of the object in that pose; `n`: how many.
    """
    height, width = size
    step = STEP * float(last.sizes[0])
    columns, rows = np.arange(step / 2, width, step), np.arange(step / 2, height, step)
    grid = np.stack(np.meshgrid(columns, rows, SIZES, TURNS, indexing="ij"), axis=-1).reshape(-1, 4)
    centre = middle - last.translations[0]
    turns = exponential(grid[:, 3:] * np.array([0.0, 1.0, 0.0]))
    tried = Poses(turns @ last.rotations[0], grid[:, :2] - centre * grid[:, 2:3], last.morphs * grid[:, 2:3])
    parts = [misfit(tried[first : first + AT_ONCE]) for first in range(0, len(tried), AT_ONCE)]
    return tried[np.argsort(np.concatenate(parts), kind="stable")[:n]]


def brought_to(model: MorphableModel, last: Poses, shown: Poses) -> Poses:
    """One pose turned in the picture's plane, scaled and moved to where others have the object, `n` poses."""
    angle = np.zeros((len(shown), 3))
    angle[:, 2] = rolls(shown) - rolls(last)
    ratio = shown.sizes[:, None] / last.sizes
    there = Poses(exponential(angle) @ last.rotations[0], np.zeros((len(shown), 2)), ratio * last.morphs)
    off = model.project(shown).mean(axis=1) - model.project(there).mean(axis=1)
    return replace(there, translations=off)


def rolls(poses: Poses) -> Array:
    """`(n,)` rad by which poses lean clockwise in the picture."""
    turns = poses.rotations
    return np.asarray(
        np.arctan2(turns[:, 1, 0] - turns[:, 0, 1], turns[:, 0, 0] + turns[:, 1, 1]), np.float64
    )


WIDTH_OF_FACE = 0.85  # of a detector's box: what lies between the ears, which a model of a face spans
FACE = 52.0  # px: width of a face in pictures given to a detector: twice what cascades were trained at
AROUND = 2.0  # side of the picture about a pose, in widths of the face's box
OFF = 0.2  # how far the middle of a box may be from that of a face which it confirms, in its widths
TRIED_SIZES = 0.7, 1.45  # of a box that confirms a face, in its widths

HERE, ANYWHERE = 1, 4
"""Neighbouring detections of a cascade that make one face: where one is known to have been, and all over a
picture. At 2400 places of films without faces four were confirmed."""

TRIED_TURNS = (0.0, 0.45, -0.45)
"""rad by which a lost face is looked for turned in the picture's plane, from how it was seen last and from
upright, one in each picture: detectors find faces up to about 0.3 rad from upright."""

LARGEST = 640  # px: longer side of the picture in which a lost face is looked for


class Finder(Protocol):
    """Anything that knows where an object is without having followed it."""

    def confirms(self, image: Image, pose: Poses) -> bool:
        """Whether the object is about where one pose has it."""
        ...

    def find(self, image: Image, last: Poses, attempt: int) -> Poses:
        """Poses that it may have, the likeliest first, perhaps none.

        `last` is the pose that it had when it was last seen, `attempt` counts the pictures since, from 0.
        """
        ...


@short_repr
@dataclass(frozen=True, eq=False)
class DetectedFace(PickledByFields):
    """A face that a detector finds."""

    model: MorphableModel  # of the person
    detector: PartDetector  # of faces

    @cached_property
    def _here(self) -> PartDetector:
        return for_height(self.detector, FACE, HERE)

    @cached_property
    def _anywhere(self) -> PartDetector:
        return for_height(self.detector, FACE, ANYWHERE)

    def confirms(self, image: Image, pose: Poses) -> bool:
        """Whether the detector finds a face in the picture about the pose, turned upright."""
        middle, width = self._box(pose)
        view = UprightView.of(middle, float(rolls(pose)[0]), FACE / width, (round(AROUND * FACE),) * 2)
        boxes = self._here(Frame(view.drawn(image), 0.0, 1))
        off = np.abs(boxes[:, :2] + boxes[:, 2:] / 2 - np.array(view.size) / 2).max(axis=1, initial=0)
        size = boxes[:, 2] / FACE
        return bool(((off < OFF * FACE) & (size > TRIED_SIZES[0]) & (size < TRIED_SIZES[1])).any())

    def find(self, image: Image, last: Poses, attempt: int) -> Poses:
        """Poses in the boxes that the detector finds in the picture turned by an angle, another each time."""
        turn = TRIED_TURNS[attempt // 2 % len(TRIED_TURNS)] + (
            float(rolls(last)[0]) if attempt % 2 == 0 else 0.0
        )
        _, width = self._box(last)
        height, across = image.shape[:2]
        scale = min(FACE / width, LARGEST / max(height, across))
        size = np.abs(np.array([[np.cos(turn), np.sin(turn)], [np.sin(turn), np.cos(turn)]])) @ (
            across,
            height,
        )
        middle = np.array([across - 1, height - 1]) / 2
        wide, high = np.ceil(scale * size).astype(int).tolist()
        view = UprightView.of(middle, turn, scale, (wide, high))
        return view.poses(self.model, self._anywhere(Frame(view.drawn(image), 0.0, 1)))

    def _box(self, pose: Poses) -> tuple[Array, float]:
        """Middle and width, px, of the box that a detector would draw about a face."""
        places = self.model.project(pose)[0]
        typical = self.model.bases[0, :, 0]
        width = float(pose.sizes[0] * np.ptp(typical)) / WIDTH_OF_FACE
        return (places.min(axis=0) + places.max(axis=0)) / 2, width


@dataclass(frozen=True, eq=False)
class UprightView:
    """A part of a picture, turned and scaled."""

    matrix: Array  # `(2, 3)`: from places of the picture to those of the view, px
    size: tuple[int, int]  # `(width, height)` px of the view

    @classmethod
    def of(cls, middle: Array, turn: float, scale: float, size: tuple[int, int]) -> Self:
        """With `middle` of the picture in its middle; what leans clockwise by `turn` rad is upright in it."""
        linear = scale * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        centre = (np.array(size) - 1) / 2
        return cls(np.column_stack([linear, centre - linear @ middle]), size)

    @property
    def scale(self) -> float:
        """Px of the view per px of the picture."""
        return float(np.hypot(*self.matrix[0, :2]))

    def drawn(self, image: Image) -> Image:
        """What it shows of a picture; beyond its edges they go on."""
        if self.scale < 1:  # of what is finer than the view's pixels nothing must be left
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 / self.scale), np.uint8)
        drawn = cv2.warpAffine(image, self.matrix, self.size, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(drawn, np.uint8)

    def poses(self, model: MorphableModel, boxes: Array) -> Poses:
        """The typical shape upright in boxes `(n, 4)` px of the view, as the picture has it."""
        upright = poses_in_boxes(model, boxes)
        back = np.linalg.inv(self.matrix[:, :2])
        turn = np.eye(3)
        turn[:2, :2] = back * self.scale
        places = (upright.translations - self.matrix[:, 2]) @ back.T
        return Poses(turn @ upright.rotations, places, upright.morphs / self.scale)


def poses_in_boxes(model: MorphableModel, boxes: Array) -> Poses:
    """The typical shape upright in boxes `(n, 4)` px of faces: x, y, width, height."""
    low, high = model.bases[0, :, :2].min(axis=0), model.bases[0, :, :2].max(axis=0)
    sizes = WIDTH_OF_FACE * boxes[:, 2] / (high[0] - low[0])
    centres = boxes[:, :2] + boxes[:, 2:] / 2
    return Poses.upright(centres - sizes[:, None] * (low + high) / 2, sizes, model.n_bases)


LEAST_SHARE = 0.5  # of the usual fit, below which the object is doubted
RETURN_SHARE = 0.75  # the same for a lost object found elsewhere: chance has had many places to try

CHANCE, CHANCE_ANYWHERE = 0.2, 0.4
"""Fits below which they are doubted whatever is usual. In films of other things, the texture of a face
explained less than 0.12 of the variance, also in the best of all places."""

MEMORY = 1.0  # s over which the usual fit is averaged
PATIENCE = 0.1  # s of doubt after which the object is lost; one picture, however late, counts for half of it

SHORTEST_TRIAL, TRIAL = 0.06, 0.2
"""s for which an object that a detector shows has to be seen there, with a texture taken there, before it is
believed: where the texture that is remembered fits better than by chance, and where it does not. Of 1200
pictures without a face four showed one, and one of these for more than three pictures."""

ROUNDING = 1e-6  # s by which sums of frame times may be off


@short_repr
@dataclass(frozen=True)
class Trust:
    """Belief of a tracker in itself."""

    # running mean of the fit over the last second in which there was no doubt; 1 before anything was seen
    usual: float = 1.0
    doubt: float = 0.0  # s for which the fit has been too low; 0 without a doubt
    # s for which an object that a detector has shown must still be seen; 0 where none is on trial
    trial: float = 0.0
    relocations: int = 0  # how often the object was lost and found again
    searches: int = 0  # pictures in which it was looked for since it was lost

    @property
    def lost(self) -> bool:
        """Whether the tracker knows that it does not follow the object."""
        return self.doubt > PATIENCE - ROUNDING

    @property
    def least_fit(self) -> float:
        """Below which the object is doubted where it is followed."""
        return max(LEAST_SHARE * self.usual, CHANCE)

    @property
    def return_fit(self) -> float:
        """From which on it is believed where it is found by its texture."""
        return max(RETURN_SHARE * self.usual, CHANCE_ANYWHERE)

    def confirmed(self, fit: float, elapsed: float) -> Self:
        """After a picture in which the object was where it was followed."""
        share = -float(np.expm1(-elapsed / MEMORY))
        return replace(self, doubt=0.0, searches=0, usual=self.usual + share * (fit - self.usual))

    def doubted(self, elapsed: float) -> Self:
        """After a picture in which it may not have been there."""
        return replace(self, doubt=self.doubt + pictures_worth(elapsed), trial=0.0)

    def seen_again(self, elapsed: float) -> Self:
        """After a picture in which its texture was found: it takes one more until it is believed."""
        return replace(
            self, doubt=pictures_worth(elapsed), trial=0.0, searches=0, relocations=self.relocations + 1
        )

    def on_trial(self, *, known: bool) -> Self:
        """After a picture in which a detector has shown it; `known` where its texture says so, too."""
        return replace(self, trial=SHORTEST_TRIAL if known else TRIAL)

    def tried(self, fit: float, elapsed: float) -> Self:
        """After a picture in which an object on trial was there once more."""
        left = self.trial - elapsed
        if left > ROUNDING:
            return replace(self, trial=left)
        return replace(self, usual=fit, doubt=0.0, trial=0.0, searches=0, relocations=self.relocations + 1)


def pictures_worth(elapsed: float) -> float:
    """S of doubt for a picture that comes so long after the one before."""
    return min(max(elapsed, ROUNDING), PATIENCE / 2)
