"""Measures of masks: pixels against labels, components against objects."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass, field
from operator import add
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Shape, checked
from ..io.ground_truth import FOREGROUND, SHADOW, BoxTruth, Kind

Mask = Annotated[NDArray[np.uint8], Shape("height", "width")]

MIN_AREA = 50
"""px; smaller connected components are noise and no extracted objects."""

_GROWTH = 0.2  # of true boxes, and the shares of the paper (§4.2) that make a ghost and a find
_GHOST_OVERLAP = 0.1
_COVERED = 0.5


@dataclass(frozen=True)
class PixelScores:
    """Pixel counts and CDnet's measures of them; a measure whose denominator is zero is NaN."""

    true_positives: int
    false_positives: int
    false_negatives: int
    true_negatives: int

    @property
    def precision(self) -> float:
        """TP / (TP + FP)."""
        return ratio(self.true_positives, self.true_positives + self.false_positives)

    @property
    def recall(self) -> float:
        """TP / (TP + FN)."""
        return ratio(self.true_positives, self.true_positives + self.false_negatives)

    @property
    def f_measure(self) -> float:
        """2 TP / (2 TP + FP + FN), the harmonic mean of precision and recall."""
        twice = 2 * self.true_positives
        return ratio(twice, twice + self.false_positives + self.false_negatives)

    @property
    def specificity(self) -> float:
        """TN / (TN + FP)."""
        return ratio(self.true_negatives, self.true_negatives + self.false_positives)

    @property
    def wrong_percent(self) -> float:
        """CDnet's PWC, 100 (FN + FP) / all."""
        wrong = self.false_negatives + self.false_positives
        return 100 * ratio(wrong, wrong + self.true_positives + self.true_negatives)


@dataclass
class PixelScore:
    """Counter of correct and wrong pixels, frame by frame.

    Shadow counts as background; pixels that are unknown or outside the region of interest do not count.
    """

    numbers: list[int] = field(default_factory=list)
    counts: list[tuple[int, int, int, int]] = field(default_factory=list)

    @checked
    def add(self, number: int, foreground: Mask, labels: Mask) -> None:
        """Count one frame.

        Parameters
        ----------
        number
            its 1-based number.
        foreground
            `(height, width)` uint8, not 0 where foreground was found.
        labels
            `(height, width)` uint8, CDnet's labels.

        Raises
        ------
        ValueError
            if the two differ in size.
        """
        claimed, positive, negative = foreground != 0, labels == FOREGROUND, labels <= SHADOW
        right, wrong = (int(np.count_nonzero(claimed & each)) for each in (positive, negative))
        missed, rest = int(np.count_nonzero(positive)) - right, int(np.count_nonzero(negative)) - wrong
        self.numbers.append(number)
        self.counts.append((right, wrong, missed, rest))

    def total(self) -> PixelScores:
        """Return the measures over all frames."""
        return _sum_counts(self.counts)

    def blocks(self, length: int = 250) -> list[tuple[int, PixelScores]]:
        """Return the number of the first frame and the measures of each block of `length` counted frames."""
        return [
            (self.numbers[start], _sum_counts(self.counts[start : start + length]))
            for start in range(0, len(self.counts), length)
        ]


def joined(scores: Iterable[PixelScore]) -> PixelScore:
    """Return one score of the frames of all scores."""
    whole = PixelScore()
    for score in scores:
        whole.numbers += score.numbers
        whole.counts += score.counts
    return whole


def total(scores: Iterable[PixelScore]) -> PixelScores:
    """Return the measures over all frames of all scores."""
    return joined(scores).total()


@dataclass(frozen=True)
class ErrorClasses:
    """Error classes of the paper (§4.2, Fig. 8), counted over frames; instances add up.

    `missed_objects` is the first two for truth that does not tell pedestrians from vehicles.
    `missed_by_pixels`, of all kinds, is the stricter count that takes the components' pixels and not their
    boxes as cover, which most walking people fail: they fill about half of their box.
    """

    missed_pedestrians: int = 0
    missed_vehicles: int = 0
    missed_objects: int = 0
    ghosts: int = 0
    missed_by_pixels: int = 0
    objects: int = 0
    """How many there were to be found."""

    @property
    def errors(self) -> int:
        """Objects missed plus ghosts."""
        return self.missed_pedestrians + self.missed_vehicles + self.missed_objects + self.ghosts

    def __add__(self, other: "ErrorClasses") -> "ErrorClasses":
        return ErrorClasses(*map(add, astuple(self), astuple(other)))


@checked
def error_classes(foreground: Mask, truth: BoxTruth) -> ErrorClasses:
    """Count missed objects and ghosts in one frame.

    Parameters
    ----------
    foreground
        `(height, width)` uint8, not 0 where foreground was found.
    truth
        the boxes of this frame.

    Notes
    -----
    Components (8-connected) smaller than `MIN_AREA` are dropped first.

    *Ghost*: less than 10 % of the component's pixels lie in true boxes (ignored ones included) grown by
    20 % about their centres. *Missed*: less than 50 % of the true box, clipped to the picture, is covered
    by the union of the bounding boxes of the components that are no ghosts. Boxes are compared with boxes,
    since a silhouette fills only about half of its box; ghosts cover nothing, since otherwise one component
    over the whole picture would find every person. Objects wholly outside the picture do not count.
    """
    height, width = foreground.shape
    labels, corners, areas = _components(foreground)
    far = np.ones((height, width), np.bool_)
    inside = np.zeros(len(areas), np.int64)
    for x0, y0, x1, y1 in _pixel_corners(truth.box, foreground.shape, _GROWTH):
        region = slice(y0, y1), slice(x0, x1)
        inside += np.bincount(labels[region][far[region]], minlength=len(areas))
        far[region] = False
    kept = areas > 0
    ghost = kept & (inside < _GHOST_OVERLAP * areas)
    cover = np.zeros((height, width), np.bool_)
    for x0, y0, x1, y1 in corners[kept & ~ghost]:
        cover[y0:y1, x0:x1] = True

    missed = {Kind.PEDESTRIAN: 0, Kind.VEHICLE: 0}
    by_pixels = objects = 0
    for kind, (x0, y0, x1, y1) in zip(truth.kind, _pixel_corners(truth.box, foreground.shape), strict=True):
        area = (x1 - x0) * (y1 - y0)
        if kind == Kind.IGNORED or area <= 0:
            continue
        objects += 1
        region = slice(y0, y1), slice(x0, x1)
        missed[Kind(kind)] += int(np.count_nonzero(cover[region]) < _COVERED * area)
        by_pixels += int(np.count_nonzero(kept[labels[region]]) < _COVERED * area)
    return ErrorClasses(
        missed_pedestrians=missed[Kind.PEDESTRIAN],
        missed_vehicles=missed[Kind.VEHICLE],
        ghosts=int(np.count_nonzero(ghost)),
        missed_by_pixels=by_pixels,
        objects=objects,
    )


@checked
def mask_error_classes(foreground: Mask, labels: Mask) -> ErrorClasses:
    """Count missed objects and ghosts in one frame of labelled masks.

    The true objects are the connected components of the labels' foreground with at least `MIN_AREA` pixels;
    one is missed if less than 50 % of its pixels belong to extracted components. A ghost has less than 10 %
    of its pixels on anything but background: where the truth is unknown, nothing is a ghost.

    Parameters
    ----------
    foreground
        `(height, width)` uint8, not 0 where foreground was found.
    labels
        `(height, width)` uint8, CDnet's labels.

    Raises
    ------
    ValueError
        if the two differ in size.
    """
    extracted, _, areas = _components(foreground)
    inside = np.bincount(extracted[labels > 0], minlength=len(areas))
    kept = areas > 0
    objects, _, sizes = _components((labels == FOREGROUND).astype(np.uint8))
    covered = np.bincount(objects[kept[extracted]], minlength=len(sizes))
    missed = int(np.count_nonzero((sizes > 0) & (covered < _COVERED * sizes)))
    return ErrorClasses(
        missed_objects=missed,
        ghosts=int(np.count_nonzero(kept & (inside < _GHOST_OVERLAP * areas))),
        missed_by_pixels=missed,
        objects=int(np.count_nonzero(sizes)),
    )


def _components(mask: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return labels, corners (x0, y0, x1, y1) and areas of components; area 0: background or too small."""
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    areas = statistics[:, cv2.CC_STAT_AREA].astype(np.int32)
    areas[areas < MIN_AREA] = 0
    areas[0] = 0
    corners = statistics[:, : cv2.CC_STAT_HEIGHT + 1].astype(np.int32)
    corners[:, 2:] += corners[:, :2]
    return labels.astype(np.int32, copy=False), corners, areas


def _pixel_corners(
    box: NDArray[np.float64], shape: tuple[int, ...], growth: float = 0.0
) -> NDArray[np.int64]:
    """Return x0, y0, x1, y1 of boxes grown about their centres, in whole pixels of the picture."""
    margin = box[:, 2:] * (growth / 2)
    corners = np.hstack([box[:, :2] - margin, box[:, :2] + box[:, 2:] + margin])
    height, width = shape
    return np.clip(np.rint(corners), 0, [width, height, width, height]).astype(np.int64)


def _sum_counts(counts: list[tuple[int, int, int, int]]) -> PixelScores:
    return PixelScores(*map(sum, zip((0, 0, 0, 0), *counts, strict=True)))


def ratio(numerator: float, denominator: float) -> float:
    """Return the ratio; NaN where the denominator is zero."""
    return numerator / denominator if denominator else float("nan")
