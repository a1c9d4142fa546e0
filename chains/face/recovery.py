"""Recovery of an object that may be lost: tests of the track, places to search, detection by a finder."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Protocol, Self, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from ...models.core.checks import CountFrom0, NotNegative, between
from ...models.core.frame import Frame
from ...models.core.short_repr import PickledByFields, short_repr
from ...models.face.detectors import FACE, PartDetector, for_height
from ...models.face.morphable_model import MorphableModel, Poses
from ...models.numerics.rotations import exponential

Array = NDArray[np.float64]
Floats = NDArray[np.floating]
Image = NDArray[np.uint8]

# Where experts start their search, chosen on generated faces in quick motion:
FARTHEST_AHEAD = 1.5  # greatest share of an expert's last motion by which it starts ahead
ASIDE = 0.5  # noise added to the start, in standard deviations of the motion
STRAIGHT = 0.25  # share of the experts without that noise

# Grid of poses for a lost object, within the basin of Gauss-Newton on the coarsest level:
STEP = 0.3  # distance between places, in sizes of the object
SIZES = (0.8, 1.0, 1.25)  # of the last size
TURNS = (-0.35, 0.0, 0.35)  # rad about the upright axis, from the last pose
BATCH = 2000  # poses evaluated at a time, which bounds the memory


def disperse(poses: Poses, motion: Array, walk: Array, random: np.random.Generator) -> Poses:
    """Return dispersed starts of the experts' searches, so that not all of them end in one wrong mode.

    Each expert continues by another share of its last motion, and most of them with noise. This changes only
    where the search starts: likelihood and prior are the same.

    `poses`: of the experts in the last picture; `motion` `(n, dimension)`: their change until now at constant
    velocity; `walk` `(dimension,)`: variances of the motion.
    """
    n, dimension = motion.shape
    share = np.linspace(0.0, FARTHEST_AHEAD, n)[random.permutation(n)]
    aside = ASIDE * np.sqrt(walk) * random.standard_normal((n, dimension))
    aside[random.random(n) < STRAIGHT] = 0.0
    return poses.moved(share[:, None] * motion + aside)


def search_grid(
    misfit: Callable[[Poses], Array], size: tuple[int, int], last: Poses, middle: Array, n: int
) -> Poses:
    """Return the `n` poses, of a grid of places, sizes and turns, whose coarse texture fits the picture best.

    `misfit`: of poses, `(n,)`, infinite outside of the picture; `size` `(height, width)` px of the picture;
    `last`: the last reliable pose, which gives rotation and shape; `middle` `(2,)` px of the object there.
    """
    height, width = size
    step = STEP * float(last.sizes[0])
    columns, rows = np.arange(step / 2, width, step), np.arange(step / 2, height, step)
    grid = np.stack(np.meshgrid(columns, rows, SIZES, TURNS, indexing="ij"), axis=-1).reshape(-1, 4)
    centre = middle - last.translations[0]
    turns = exponential(grid[:, 3:] * np.array([0.0, 1.0, 0.0]))
    tried = Poses(turns @ last.rotations[0], grid[:, :2] - centre * grid[:, 2:3], last.morphs * grid[:, 2:3])
    parts = [misfit(tried[first : first + BATCH]) for first in range(0, len(tried), BATCH)]
    return tried[np.argsort(np.concatenate(parts), kind="stable")[:n]]


def align_to_detections(model: MorphableModel, last: Poses, detected: Poses) -> Poses:
    """Turn one pose in the picture's plane, scale it and move it to each of `n` detected poses."""
    angle = np.zeros((len(detected), 3))
    angle[:, 2] = roll_angles(detected) - roll_angles(last)
    ratio = detected.sizes[:, None] / last.sizes
    there = Poses(exponential(angle) @ last.rotations[0], np.zeros((len(detected), 2)), ratio * last.morphs)
    off = model.project(detected).mean(axis=1) - model.project(there).mean(axis=1)
    return replace(there, translations=off)


def roll_angles(poses: Poses) -> Array:
    """Return the clockwise roll of poses in the picture, `(n,)` rad."""
    turns = poses.rotations
    return np.asarray(
        np.arctan2(turns[:, 1, 0] - turns[:, 0, 1], turns[:, 0, 0] + turns[:, 1, 1]), np.float64
    )


WIDTH_OF_FACE = 0.85  # width between the ears, which a face model spans, over that of a detector's box
AROUND = 2.0  # side of the picture cut out about a pose, in widths of the face's box
OFF = 0.2  # greatest distance of a confirming box from the face, in widths of the box
TRIED_SIZES = 0.7, 1.45  # range of a confirming box's width over the expected one

HERE, ANYWHERE = 1, 4
"""`min_neighbors` of a cascade that confirms a face at a known place, and of one that searches a picture. At
2400 places of films without faces four were confirmed."""

TRIED_TURNS = (0.0, 0.45, -0.45)
"""Rolls at which a lost face is searched for, rad, from its last roll and from upright, one in each picture:
detectors find faces up to about 0.3 rad from upright."""

LARGEST = 640  # px: longer side of the picture in which a lost face is searched for


@runtime_checkable
class Finder(Protocol):
    """Detector of an object, without memory of its track."""

    def confirms(self, image: Image, pose: Poses) -> bool:
        """Return whether the object is detected about the given pose."""
        ...

    def find(self, image: Image, last: Poses, attempt: int) -> Poses:
        """Return candidate poses, the likeliest first; there may be none.

        `last` is the last reliable pose, `attempt` counts the pictures since then, from 0.
        """
        ...


@short_repr
@dataclass(frozen=True, eq=False)
class DetectedFace(PickledByFields):
    """Finder of a face by a face detector."""

    model: MorphableModel  # of the person
    detector: PartDetector  # of faces

    @cached_property
    def _here(self) -> PartDetector:
        return for_height(self.detector, FACE, HERE)

    @cached_property
    def _anywhere(self) -> PartDetector:
        return for_height(self.detector, FACE, ANYWHERE)

    def confirms(self, image: Image, pose: Poses) -> bool:
        """Return whether the detector finds a face about the pose, in the picture turned upright."""
        middle, width = self._box(pose)
        view = UprightView.of(middle, float(roll_angles(pose)[0]), FACE / width, (round(AROUND * FACE),) * 2)
        boxes = self._here(Frame(view.warp(image), 0.0, 1))
        off = np.abs(boxes[:, :2] + boxes[:, 2:] / 2 - np.array(view.size) / 2).max(axis=1, initial=0)
        size = boxes[:, 2] / FACE
        return bool(((off < OFF * FACE) & (size > TRIED_SIZES[0]) & (size < TRIED_SIZES[1])).any())

    def find(self, image: Image, last: Poses, attempt: int) -> Poses:
        """Return poses in the detector's boxes, in the picture turned by another angle at each attempt."""
        turn = TRIED_TURNS[attempt // 2 % len(TRIED_TURNS)] + (
            float(roll_angles(last)[0]) if attempt % 2 == 0 else 0.0
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
        return view.poses(self.model, self._anywhere(Frame(view.warp(image), 0.0, 1)))

    def _box(self, pose: Poses) -> tuple[Array, float]:
        """Return middle and width, px, of the box that a detector would give for a face."""
        places = self.model.project(pose)[0]
        typical = self.model.bases[0, :, 0]
        width = float(pose.sizes[0] * np.ptp(typical)) / WIDTH_OF_FACE
        return (places.min(axis=0) + places.max(axis=0)) / 2, width


@dataclass(frozen=True, eq=False)
class UprightView:
    """View of a part of a picture, turned upright and scaled."""

    matrix: Array  # `(2, 3)`: from places of the picture to those of the view, px
    size: tuple[int, int]  # `(width, height)` px of the view

    @classmethod
    def of(cls, middle: Array, turn: float, scale: float, size: tuple[int, int]) -> Self:
        """Return the view about `middle` in which a clockwise lean by `turn` rad is upright."""
        linear = scale * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        centre = (np.array(size) - 1) / 2
        return cls(np.column_stack([linear, centre - linear @ middle]), size)

    @property
    def scale(self) -> float:
        """Px of the view for a px of the picture."""
        return float(np.hypot(*self.matrix[0, :2]))

    def warp(self, image: Image) -> Image:
        """Return the picture in this view, with its border replicated."""
        if self.scale < 1:  # anti-aliasing
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.4 / self.scale), np.uint8)
        view = cv2.warpAffine(image, self.matrix, self.size, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(view, np.uint8)

    def poses(self, model: MorphableModel, boxes: Array) -> Poses:
        """Return poses, in the picture, of the typical shape upright in boxes `(n, 4)` px of the view."""
        upright = poses_in_boxes(model, boxes)
        back = np.linalg.inv(self.matrix[:, :2])
        turn = np.eye(3)
        turn[:2, :2] = back * self.scale
        places = (upright.translations - self.matrix[:, 2]) @ back.T
        return Poses(turn @ upright.rotations, places, upright.morphs / self.scale)


def poses_in_boxes(model: MorphableModel, boxes: Array) -> Poses:
    """Return poses of the typical shape upright in face boxes `(n, 4)` px: x, y, width, height."""
    low, high = model.bases[0, :, :2].min(axis=0), model.bases[0, :, :2].max(axis=0)
    sizes = WIDTH_OF_FACE * boxes[:, 2] / (high[0] - low[0])
    centres = boxes[:, :2] + boxes[:, 2:] / 2
    return Poses.upright(centres - sizes[:, None] * (low + high) / 2, sizes, model.n_bases)


LEAST_SHARE = 0.5  # of the usual fit, below which the object is doubted

CHANCE, CHANCE_ANYWHERE = 0.2, 0.4
"""Least fits, whatever the usual one, of a tracked and of a found object. In films of other things the
texture of a face explained less than 0.12 of the variance, also in the best of all places; on other faces up
to 0.29."""

MEMORY = 1.0  # s: time constant of the usual fit and area; a lost object is searched for as it was before
MAX_DOUBT_TIME = 0.1  # s of low fit after which the object is lost; one picture counts for half of it at most

SHORTEST_TRIAL, TRIAL = 0.06, 3.0
"""s by which pictures that confirm a detected object have to outweigh the others before it is tracked again:
if the old texture fits better than by chance, and if it does not, since it may be another that hides the
object for a second or two. Of 1200 pictures without a face four showed one, and one of these for more than
three pictures."""

HERE_FOR, AWAY_FOR = 60.0, 2.0
"""s: mean times for which a face is in view, and is hidden or gone: round numbers, which matter only for a
picture or two after a change."""

ROUNDING = 1e-6  # s: rounding of sums of frame times


@short_repr
@dataclass(frozen=True)
class Trust:
    """Whether an object is tracked, doubted, lost, or on trial after a detection."""

    usual_fit: float = 1.0  # running mean of the fit without a doubt; 1 before the first picture
    usual_area: NotNegative = 0.0  # the same of the area of the texture in view; 0 before the first picture
    doubt: NotNegative = 0.0  # s for which the fit has been too low
    trial: NotNegative = 0.0  # s for which a detected object must still be confirmed; 0 without a trial
    relocations: CountFrom0 = 0  # number of times that the object was lost and found again
    searches: CountFrom0 = 0  # pictures searched since it was lost
    # that the object is where it is tracked, see `probability_after`
    probability: Annotated[float, between(0, 1)] = 1.0

    @property
    def lost(self) -> bool:
        """Whether the object is lost."""
        return self.doubt > MAX_DOUBT_TIME - ROUNDING

    @property
    def least_fit(self) -> float:
        """Fit of a tracked object below which it is doubted."""
        return max(LEAST_SHARE * self.usual_fit, CHANCE)

    @property
    def return_fit(self) -> float:
        """Fit from which on an object found by its texture is accepted."""
        return max(self.least_fit, CHANCE_ANYWHERE)

    def evidence(self, fit: float | Floats, area: float | Floats) -> Array:
        """Return the fits with which the usual area would have the log likelihood that `area` has with `fit`.

        log(1 - fit) is proportional to that of a pixel (see `GFlowState.fit`): what shrinks or turns aside,
        until next to nothing of it is seen, explains little, however well.
        """
        seen = np.minimum(area / self.usual_area, 1.0) if self.usual_area else 1.0
        return np.asarray(1 - (1 - fit) ** seen)

    def probability_after(self, fit: float, area: float, elapsed: float) -> float:
        """Return the probability that the object is where it is tracked, given a picture and those before.

        The forward step of a Markov chain of two states, here and away. Evidence is normal: about the usual
        fit if the object is here, with `least_fit` at two standard deviations, and no less likely above;
        about 0 if it is away, with `CHANCE` at two.
        """
        evidence, usual = float(self.evidence(fit, area)), max(self.usual_fit, 2 * CHANCE)
        stays, returns = np.exp(-elapsed / HERE_FOR), -np.expm1(-elapsed / AWAY_FOR)
        prior = self.probability * stays + (1 - self.probability) * returns
        deviations = LEAST_SHARE / 2 * usual, CHANCE / 2
        here, away = min(evidence - usual, 0.0) / deviations[0], max(evidence, 0.0) / deviations[1]
        log_ratio = -0.5 * (here**2 - away**2) - np.log(deviations[0] / deviations[1])
        return float(expit(logit(prior) + log_ratio))

    def confirmed(self, fit: float, area: float, elapsed: float) -> Self:
        """Update with a picture in which the object was tracked."""
        share = -float(np.expm1(-elapsed / MEMORY))
        return replace(
            self,
            doubt=0.0,
            searches=0,
            usual_fit=self.usual_fit + share * (fit - self.usual_fit),
            usual_area=self.usual_area + share * (area - self.usual_area) if self.usual_area else area,
        )

    def doubted(self, elapsed: float) -> Self:
        """Update with a picture in which the fit was too low."""
        return replace(self, doubt=self.doubt + doubt_of_picture(elapsed), trial=0.0)

    def reacquired(self, elapsed: float) -> Self:
        """Update with a picture in which the texture was found; one more picture has to confirm it."""
        return replace(
            self, doubt=doubt_of_picture(elapsed), trial=0.0, searches=0, relocations=self.relocations + 1
        )

    def start_trial(self, *, matches: bool) -> Self:
        """Start a trial of a detected object, a shorter one if the old texture `matches`."""
        return replace(
            self, doubt=max(self.doubt, MAX_DOUBT_TIME), trial=SHORTEST_TRIAL if matches else TRIAL
        )

    def continue_trial(self, fit: float, elapsed: float, *, confirmed: bool) -> "Trust":
        """Update with a picture that did or did not confirm an object on trial; 0 is left if it failed."""
        left = self.trial - elapsed if confirmed else self.trial + elapsed
        if left > TRIAL + ROUNDING:
            return replace(self, trial=0.0)
        if left > ROUNDING:
            return replace(self, trial=left)
        return Trust(usual_fit=fit, relocations=self.relocations + 1)


def doubt_of_picture(elapsed: float) -> float:
    """Return the doubt, s, that one picture adds, `elapsed` s after the last one."""
    return min(max(elapsed, ROUNDING), MAX_DOUBT_TIME / 2)
