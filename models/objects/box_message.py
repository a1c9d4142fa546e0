"""What chains and detectors say to each other about the boxes of objects, and how a detector behaves."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import log
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.moving_camera import View
from ..core.checks import NotNegative, Positive, Probability, Shape, Share, checked, made
from ..core.gaussian_message import GaussianMessage
from ..core.identities import find, union
from ..core.short_repr import short_repr

Numbers = NDArray[np.float64]

FOOT_X, FOOT_Y, WIDTH, HEIGHT = range(4)
"""Order of a box's numbers (px): middle of its bottom edge, as column and row, then its size."""

BOX = 4  # numbers of a box
HEIGHTS = log(20)  # of log height, the range over which false boxes are spread evenly
SIZES = HEIGHTS * log(40)  # and of log height and log aspect


def log_anywhere(boxes: Numbers, area: float) -> Numbers:
    """Return `(n,)` nats, of 1/px^4: a box anywhere in a picture of `area` px, of any size and shape."""
    return np.asarray(-np.log(area * SIZES * boxes[:, WIDTH] * boxes[:, HEIGHT]))


@short_repr
@checked
@dataclass(frozen=True)
class Scores:
    """Mean scores of true and of false boxes: Gaussians with one deviation, so that log odds are linear."""

    true: float
    false: float
    deviation: Positive

    def log_ratio(self, scores: Numbers) -> Numbers:
        """Return `(n,)` nats: log of p(score | true box) over p(score | false box)."""
        off: Numbers = scores - 0.5 * (self.true + self.false)
        return (self.true - self.false) / self.deviation**2 * off


@short_repr
@checked
@dataclass(frozen=True)
class BoxDetector:
    """Error model of a detector of boxes.

    Parameters
    ----------
    found
        probability of detecting a fully visible object.
    clutter
        1/px^2: density of false boxes in a frame.
    position, size
        standard deviations of the foot and of the sides of a box, relative to the root of its area and to
        each side.
    doubles
        share of detected objects with a second, less accurate box.
    newcomers
        mean number of objects per frame that are detected for the first time.
    repeated
        probability of making an error again, over that of finding an object in its place.
    scores
        distributions of scores; `None` while unknown.
    """

    found: Probability = 0.9
    clutter: Positive = 1e-6
    position: Positive = 0.08
    size: Positive = 0.15
    doubles: Positive = 0.1
    newcomers: Positive = 0.1
    repeated: Probability = 0.6
    scores: Scores | None = None

    def noise(self, boxes: Numbers) -> Numbers:
        """Return `(n, 4)` px^2: variances of the errors of boxes `(n, 4)`."""
        width, height = np.maximum(boxes[:, WIDTH], 1.0), np.maximum(boxes[:, HEIGHT], 1.0)
        place = self.position**2 * width * height
        return np.stack([place, place, (self.size * width) ** 2, (self.size * height) ** 2], axis=1)


@short_repr
@checked
@dataclass(frozen=True, eq=False)
class LogOdds:
    """Log odds of a binary variable by identity: factors exp(values_k) if it is true, 1 if not.

    `identities` `(n,)` int64 are increasing; `values` in nats are 0 for all other objects.
    """

    identities: Annotated[NDArray[np.int64], Shape("n")] = field(
        default_factory=lambda: np.zeros(0, np.int64)
    )
    values: Annotated[Numbers, Shape("n")] = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.identities)

    def __mul__(self, other: Self) -> Self:
        if not self.identities.size or not other.identities.size:
            return self if self.identities.size else other
        both, _, _ = union(self.identities, other.identities)
        return type(self)(both, self.of(both) + other.of(both))

    def distance(self, other: Self) -> float:
        """Return the greatest difference of the probabilities."""
        both, _, _ = union(self.identities, other.identities)
        one, two = (0.5 * np.tanh(0.5 * odds.of(both)) for odds in (self, other))
        return float(np.abs(one - two).max(initial=0.0))

    def of(self, identities: ArrayLike) -> Numbers:
        """Return the log odds of objects, in their order."""
        place, is_mentioned = find(self.identities, identities)
        if not len(self):
            return np.zeros(place.shape)
        return np.asarray(np.where(is_mentioned, self.values[place], 0.0))


@short_repr
@checked
@dataclass(frozen=True, eq=False)
class Newcomers:
    """Density of the box of a new object, wherever in the picture its feet are.

    Height is Gaussian about a line in the foot's row, width over height is Gaussian.
    """

    size: tuple[int, int]  # (height, width) px of the picture
    # (2,): px height with the foot in the middle row, and px it grows with each row
    line: Annotated[Numbers, Shape(2)]
    line_covariance: Annotated[Numbers, Shape(2, 2)]
    variation: NotNegative  # standard deviation of heights over what the line gives, as a share of that
    aspect: float  # width over height
    aspect_variance: NotNegative
    outliers: Share = 0.1  # of new objects, which are anywhere and of any size

    def height(self, foot_y: ArrayLike) -> tuple[Numbers, Numbers]:
        """Return mean and standard deviation px of the height with feet in these rows, in their shape."""
        below = np.asarray(foot_y, np.float64) - 0.5 * self.size[0]
        covariance = self.line_covariance
        mean = self.line[0] + self.line[1] * below
        variance = covariance[0, 0] + 2 * below * covariance[0, 1] + below**2 * covariance[1, 1]
        return mean, np.sqrt(variance + (self.variation * mean) ** 2)

    def log_density(self, boxes: Numbers, noise: Numbers | None = None) -> Numbers:
        """Return `(n,)` nats of `(n, 4)` boxes, in 1/px^4; `noise` `(n, 4)` px^2 is that of observed ones."""
        more = np.zeros_like(boxes) if noise is None else noise
        mean, deviation = self.height(boxes[:, FOOT_Y])
        variance = deviation**2 + more[:, HEIGHT]
        height = np.maximum(boxes[:, HEIGHT], 1.0)
        across = height**2 * self.aspect_variance + more[:, WIDTH] + self.aspect**2 * more[:, HEIGHT]
        off = (boxes[:, HEIGHT] - mean) ** 2 / variance
        off += (boxes[:, WIDTH] - self.aspect * height) ** 2 / across
        density: Numbers = -0.5 * (off + np.log(2 * np.pi * variance) + np.log(2 * np.pi * across))
        area = float(self.size[0] * self.size[1])
        outlying = np.log(self.outliers) + log_anywhere(boxes, area)
        return np.asarray(np.logaddexp(np.log1p(-self.outliers) - np.log(area) + density, outlying))


def error_probabilities(log_odds: Numbers) -> Numbers:
    """Return probabilities `(n, 2)` of errors, given no object, from log odds over there being nothing."""
    odds = np.exp(log_odds)
    return np.asarray(odds / (1 + odds.sum(axis=1, keepdims=True)))


@short_repr
@checked
@dataclass(frozen=True, eq=False)
class Errors:
    """What candidates are if they are no objects: errors of the detector that stay or move along, or nothing.

    `identities` `(n,)` int64 are increasing. `log_odds` `(n, 2)` nats are of either kind of error over there
    being nothing, `places` `(n, 4)` px the boxes of errors that stay.
    """

    identities: Annotated[NDArray[np.int64], Shape("n")]
    log_odds: Annotated[Numbers, Shape("n", 2)]
    places: Annotated[Numbers, Shape("n", BOX)]

    def of(self, identities: NDArray[np.int64]) -> tuple[Numbers, Numbers]:
        """Return the probabilities `(n, 2)` of either kind, given no object, and the places `(n, 4)`.

        Others than candidates are no errors.
        """
        probabilities, places = np.zeros((len(identities), 2)), np.ones((len(identities), BOX))
        place, is_known = find(self.identities, identities)
        probabilities[is_known] = error_probabilities(self.log_odds[place[is_known]])
        places[is_known] = self.places[place[is_known]]
        return probabilities, places


@short_repr
@checked
@dataclass(frozen=True, eq=False)
class ErrorPlaces:
    """Where a detector errs again and again: boxes `(n, 4)` px, and mean numbers of errors `(n,)` a frame."""

    boxes: Annotated[Numbers, Shape("n", BOX)]
    rates: Annotated[Numbers, Shape("n")]


@short_repr
@dataclass(frozen=True, eq=False)
class Association:
    """Joint association of the boxes of a frame with expected and new objects."""

    boxes: Numbers  # (n_boxes, 4) px that the detector has found: foot x, foot y, width, height
    noise: Numbers  # (n_boxes, 4) px^2, variances of their errors, by their own sizes
    scores: Numbers  # (n_boxes,) of the detector, all 1 where it gives none
    identities: NDArray[np.int64]  # (n_objects,): who was expected
    pairs: Numbers  # (n_objects, n_boxes) probability that the object exists and this is its box
    followed: Numbers  # (n_objects, n_boxes) probability that this is its box, of an object or an error
    unfollowed: Numbers  # (n_objects,) probability that it has no box, and is an object or an error
    # (n_objects, n_boxes, 4) px^2, of the errors of each box as that of each object, by the size that is
    # expected of it: by the boxes' own sizes, boxes that are too small would count for more
    own_noise: Numbers
    worth: Numbers  # (n_objects, n_boxes) of the same: 1 of a usual box, less of an outlying one
    errors: Numbers  # (n_objects, 2) nats: log ratio of the boxes if it is an error, over nothing
    expected: Numbers  # (n_objects,) probability that the object, if it exists, would be found
    missed: Numbers  # (n_objects,) probability that the object exists and has no box
    visible: Numbers  # (n_objects,) share of each that is in sight
    new: Numbers  # (n_boxes,) probability that the box is of a new object
    double: Numbers  # (n_boxes,) probability that it is a second box of one object
    false: Numbers  # (n_boxes,) probability that it is false, and of no place where errors are expected
    log_evidence: float  # log density of all boxes together, given who was expected
    outlines: NDArray[np.bool_] | None = None  # (n_boxes, height, width), if the detector gives them

    def __len__(self) -> int:
        return len(self.boxes)

    @cached_property
    def information(self) -> tuple[Numbers, Numbers]:
        """`(n_objects, 4)` precisions of each object's box, 1/px^2 (0 if missed), and times the mean.

        That is the mean of the likelihood's logarithm over all assignments and outlying boxes.
        """
        something = np.maximum(self.followed.sum(axis=1) + self.unfollowed, 1e-30)
        weight = self.worth * self.followed / something[:, None]
        precision = weight[:, :, None] / self.own_noise
        return precision.sum(axis=1), (precision * self.boxes).sum(axis=1)

    @property
    def in_sight(self) -> float:
        """Expected number of objects that were missed though they could be seen."""
        return float((self.missed * self.visible).sum())

    @property
    def wrong(self) -> Numbers:
        """`(n_boxes,)` probability that a box is that of an error that is made again."""
        return np.asarray((self.followed - self.pairs).sum(axis=0))

    @property
    def true(self) -> Numbers:
        """`(n_boxes,)` probability that a box is the one box of an object, expected or new."""
        return np.asarray(self.pairs.sum(axis=0) + self.new)


NO_BOXES = GaussianMessage.uniform(BOX)
EVEN = LogOdds()


@short_repr
@checked
@dataclass(frozen=True, eq=False)
class BoxMessage:
    """Product of factors over the boxes of all objects."""

    objects: GaussianMessage = NO_BOXES  # that are seen or observed
    # of which this frame's pixels show too little: a detector may find them; no chain learns from them
    hidden: GaussianMessage = NO_BOXES
    existence: LogOdds = EVEN  # that an object is one of those that the detector is made to find
    noticed: LogOdds = EVEN  # that it is in a phase in which the detector finds it when it is in sight
    errors: Errors | None = None  # what candidates are if they are no such object; at most one sender
    places: ErrorPlaces | None = None  # where the detector errs again and again; at most one sender
    newcomers: Newcomers | None = None  # where and how large new objects are; at most one sender
    detector: BoxDetector | None = None  # how reliable the detector is; at most one sender
    # from the evidence: which detection belongs to whom; None if no detector has run
    association: Association | None = None
    view: View | None = None  # map from the scene, in whose px all boxes are, to the frame; None: the same

    def __mul__(self, other: Self) -> Self:
        for name in ("errors", "places", "newcomers", "detector", "association"):
            if getattr(self, name) is not None and getattr(other, name) is not None:
                raise ValueError(f"box message: got two factors {name}, expected at most one")
        return made(
            type(self),
            self.objects * other.objects,
            self.hidden * other.hidden,
            self.existence * other.existence,
            self.noticed * other.noticed,
            self.errors or other.errors,
            self.places or other.places,
            self.newcomers or other.newcomers,
            self.detector or other.detector,
            # one without boxes, which is false, says that the detector has run
            other.association if self.association is None else self.association,
            self.view or other.view,
        )

    def in_frame(self, boxes: Numbers) -> Numbers:
        """Return boxes `(n, 4)` of the scene as the frame shows them."""
        return boxes if self.view is None else self.view.map.boxes(boxes)

    def in_scene(self, boxes: Numbers) -> Numbers:
        """Return boxes `(n, 4)` of the frame as they are in the scene."""
        return boxes if self.view is None else self.view.map.inverse.boxes(boxes)

    def outlines_in_scene(self, masks: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return masks `(n, height, width)` of the frame as they are in the scene."""
        if self.view is None or not len(masks):
            return masks
        return np.stack([self.view.map.mask_to_scene(mask) for mask in masks])

    def variances_by_view(self, boxes: Numbers) -> Numbers:
        """Return `(n, 4)` px^2, of boxes in the scene as seen in the frame, by what the view is unsure of."""
        if self.view is None:
            return np.zeros_like(boxes)
        return np.asarray(self.view.box_variances(boxes) / np.tile(self.view.map.scale**2, 2))

    def distance(self, other: Self) -> float:
        """Return the greatest distance of boxes and odds of two messages."""
        return max(
            self.objects.distance(other.objects),
            self.hidden.distance(other.hidden),
            self.existence.distance(other.existence),
            self.noticed.distance(other.noticed),
        )

    @property
    def gaussians(self) -> GaussianMessage:
        """Gaussians of boxes of visible or observed objects, px."""
        return self.objects

    def with_gaussians(self, gaussians: GaussianMessage) -> Self:
        """Return the message with other Gaussians of boxes."""
        return replace(self, objects=gaussians)

    @property
    def expected(self) -> GaussianMessage:
        """Boxes of all objects, seen or remembered."""
        return self.objects * self.hidden

    @property
    def log_mass(self) -> float:
        """Log of the integral over all boxes, and over existence, each factor on its own."""
        detections = 0.0 if self.association is None else self.association.log_evidence
        return self.objects.log_mass + self.hidden.log_mass + detections
