"""State of the flesh tracker: hypotheses of which blob was which part, clutter, and the reach of hands."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import UpperBody
from ...models.core.checks import (
    LOG_WEIGHTS,
    NO_NAN,
    POSITIVES,
    PROBABILITIES,
    NotNegative,
    PositiveOrInfinite,
    Shape,
    SizesOf,
)
from ...models.core.gaussian_mixtures import log_sums
from ...models.core.short_repr import Rows, short_repr
from .flesh_assignment import MovingParts

Array = NDArray[np.float64]

MOST_CLUTTER = 12  # of each hypothesis: as many as an image may have blobs
DETECTED = 0.9  # detection probability of clutter that exists
LIFETIME = 20.0  # s for which clutter stays, on average
BIRTH = 0.3  # probability that a new detection of no part stays
LEAST_OLD = 1e-9  # probability that a detection is old clutter, at least
MOST_EXISTENCE = 0.99  # however often it was seen, it may have gone since then


@short_repr
@dataclass(frozen=True, eq=False)
class Clutter(Rows):
    """Resting blobs that are no part, under each of n hypotheses."""

    places: Annotated[Array, Shape("n", "k", 2)]  # px
    variances: Annotated[Array, Shape("n", "k"), POSITIVES]  # px^2, along each axis
    # probability that it is still there; 0 of an empty place
    existence: Annotated[Array, Shape("n", "k"), PROBABILITIES]

    @classmethod
    def none(cls, n_hypotheses: int) -> Self:
        """Return no clutter for each of the hypotheses."""
        shape = (n_hypotheses, 0)
        return cls(np.zeros((*shape, 2)), np.ones(shape), np.zeros(shape))

    def predict(self, dt: float, drift: float) -> Self:
        """Predict it `dt` s ahead; `drift` is in px per square root of a second."""
        existence = self.existence * np.exp(-dt / LIFETIME)
        return replace(self, variances=self.variances + drift**2 * dt, existence=existence)


@dataclass(frozen=True, eq=False)
class ClutterMatch:
    """Association of an image's k detections with clutter, under each hypothesis, if they are no part."""

    clutter: Clutter  # before the image
    # `(k, 2)` px and `(k,)` px^2 of the detections
    means: Array
    variances: Array
    new: NDArray[np.bool_]  # `(k,)`: whether a detection may be clutter
    pairs: NDArray[np.intp]  # `(H, k)`: index of the clutter, -1 for new clutter
    gains: Array  # `(H, k)` nats: log ratio of that clutter against new clutter, which has 0

    @classmethod
    def of(cls, clutter: Clutter, means: Array, variances: Array, densities: Array, jitter: float) -> Self:
        """Pair detections and clutter that are each other's best.

        `densities` `(k,)` of new clutter, per px^2; infinite for a detection that is never clutter; `jitter`
        px, standard deviation with which clutter is detected again.
        """
        n_hypotheses, n_clutter = clutter.existence.shape
        new = np.isfinite(densities)
        if not n_clutter or not len(means):
            none = np.full((n_hypotheses, len(means)), -1)
            return cls(clutter, means, variances, new, none, np.zeros(none.shape))
        total = clutter.variances[:, :, None] + variances + jitter**2
        squares = ((clutter.places[:, :, None] - means) ** 2).sum(axis=-1)
        with np.errstate(divide="ignore"):
            there = np.log(DETECTED * clutter.existence)[:, :, None]
        gains = there - np.log(2 * np.pi * total * densities) - 0.5 * squares / total
        best = gains.argmax(axis=1)
        mutual = np.take_along_axis(gains.argmax(axis=2), best, 1) == np.arange(len(means))
        gain = np.take_along_axis(gains, best[:, None], 1)[:, 0]
        paired = mutual & (gain > 0)
        return cls(clutter, means, variances, new, np.where(paired, best, -1), np.where(paired, gain, 0.0))

    @property
    def log_absent(self) -> Array:
        """`(H,)` nats: log probability that all unpaired clutter is missed."""
        paired = (self.pairs[:, :, None] == np.arange(self.clutter.existence.shape[1])).any(axis=1)
        return np.asarray(np.where(paired, 0.0, np.log1p(-DETECTED * self.clutter.existence)).sum(axis=1))

    @property
    def log_old(self) -> Array:
        """`(H, k)` nats of `old`, `LEAST_OLD` at least."""
        return np.asarray(np.log(np.maximum(self.old, LEAST_OLD)))

    @property
    def old(self) -> Array:
        """`(H, k)`: probability that a detection, if it is no part, is clutter that was there before."""
        return np.where(self.pairs >= 0, 1 / (1 + np.exp(-self.gains)), 0.0)

    def updated(self, hypotheses: NDArray[np.intp], parts: Array, radius: float) -> Clutter:
        """Update the clutter for m continuations of hypotheses.

        A detection within `radius` px of a part is no clutter, and covers the clutter there.

        `hypotheses` `(m,)`: which one each continues; `parts` `(m, n_parts, 2)` px: detected parts, NaN for
        others.
        """
        before, pairs = self.clutter.only(hypotheses), self.pairs[hypotheses]
        of_part = _near(self.means[None], parts, radius)
        rows = np.arange(len(hypotheses))[:, None]
        places, variances, existence = before.places.copy(), before.variances.copy(), before.existence
        missed = existence * (1 - DETECTED) / (1 - DETECTED * existence)
        existence = np.where(_near(places, parts, radius), existence, missed)
        row, detection = np.nonzero((pairs >= 0) & ~of_part)
        old = pairs[row, detection]
        gain = variances[row, old] / (variances[row, old] + self.variances[detection])
        places[row, old] += gain[:, None] * (self.means[detection] - places[row, old])
        variances[row, old] *= 1 - gain
        existence[row, old] = np.minimum(self.old[hypotheses][row, detection], MOST_EXISTENCE)
        born = np.where((pairs < 0) & ~of_part & self.new, BIRTH, 0.0)
        shape = born.shape
        new = np.broadcast_to(self.means, (*shape, 2)), np.broadcast_to(self.variances, shape), born
        both = zip((places, variances, existence), new, strict=True)
        every = [np.concatenate(pair, axis=1) for pair in both]
        kept = np.argsort(-every[2], axis=1, kind="stable")[:, :MOST_CLUTTER]
        return Clutter(*(each[rows, kept] for each in every))


def _near(places: Array, parts: Array, radius: float) -> NDArray[np.bool_]:
    """`(m, n)`: whether `places` `(m, n, 2)` are within a radius of any of `parts` `(m, n_parts, 2)`."""
    squares = ((places[:, :, None] - parts[:, None]) ** 2).sum(axis=-1)
    return np.asarray((squares < radius**2).any(axis=2))


HEAD, LEFT, RIGHT = range(3)
HANDS = [LEFT, RIGHT]
EXCHANGED = [HEAD, RIGHT, LEFT]
OF_PARTS = ("means", "covariances", "visible", "since", "detections")

MOST_HYPOTHESES = 16

EXCHANGES = 4  # hypotheses, the best ones, that get a twin with exchanged hands
ALIKE = 0.6  # of a hand's radius, or of a standard deviation: hypotheses that are so close are merged
LEAST_WEIGHT = 1e-5  # over that of the best hypothesis: one with less is dropped


@short_repr
@dataclass(frozen=True, eq=False)
class FleshTracks:
    """Weighted hypotheses of head, left hand and right hand, in each of which parts are Gaussians."""

    size: Annotated[tuple[int, int], SizesOf("height", "width")]  # px of the image
    max_coast_time: PositiveOrInfinite  # s without a detection after which a part is lost
    # of weights that sum to 1; the best one first
    log_weights: Annotated[Array, Shape("n", finite=False), LOG_WEIGHTS]
    means: Annotated[Array, Shape("n", 3, 4)]  # x, y px and their velocities px/s
    covariances: Annotated[Array, Shape("n", 3, 4, 4)]  # in the same order
    visible: Annotated[Array, Shape("n", 3), PROBABILITIES]  # probability that a part is not hidden
    # s since a part was last detected; infinite before the first time
    since: Annotated[Array, Shape("n", 3, finite=False), NO_NAN]
    # label of the detection that a part was or was hidden by, or -1
    detections: Annotated[NDArray[np.int64], Shape("n", 3)]
    clutter: Clutter
    elapsed: NotNegative = 0.0  # s since the last update

    def require_fit(self) -> None:
        """Raise a `ValueError` if the clutter is not that of all hypotheses."""
        known, n = len(self.clutter.places), len(self.log_weights)
        if known != n:
            raise ValueError(f"clutter: got that of {known} hypotheses, expected {n}")

    @cached_property
    def weights(self) -> Array:
        """`(H,)`, with sum 1."""
        return np.exp(self.log_weights)

    @property
    def trust(self) -> Array:
        """`(H, 3)`: probability that a part has not jumped since it was last seen."""
        return np.exp(-self.since / self.max_coast_time)

    @property
    def positions(self) -> Array:
        """`(3, 2)` px, under the best hypothesis."""
        return np.asarray(self.means[0, :, :2])

    @property
    def position_covariances(self) -> Array:
        """`(3, 2, 2)` px^2: second moments of all hypotheses about `positions`."""
        apart = self.means[..., :2] - self.positions
        scatter = self.covariances[..., :2, :2] + apart[..., :, None] * apart[..., None, :]
        return np.asarray(np.einsum("h,hpxy->pxy", self.weights, scatter))

    @property
    def unseen(self) -> Array:
        """`(3,)` s since a part was last detected, under the best hypothesis."""
        return np.asarray(self.since[0])

    @property
    def labels(self) -> NDArray[np.int64]:
        """`(3,)` detections that parts are under the best hypothesis, -1 for none."""
        return np.asarray(self.detections[0])

    @property
    def lost(self) -> NDArray[np.bool_]:
        """`(3,)`: whether a part was not detected for more than `max_coast_time`."""
        return np.asarray(self.unseen > self.max_coast_time)

    def take(self, hypotheses: NDArray[np.intp]) -> Self:
        """Select hypotheses, with their weights."""
        rows: dict[str, Any] = {name: getattr(self, name)[hypotheses] for name in ("log_weights", *OF_PARTS)}
        return replace(self, **rows, clutter=self.clutter.only(hypotheses))

    def exchanged(self) -> Self:
        """Exchange the states of left and right hand."""
        return replace(self, **{name: getattr(self, name)[:, EXCHANGED] for name in OF_PARTS})

    def with_exchanges(self, time: float) -> Self:
        """Add hypotheses in which the hands were exchanged since the last update.

        Exchanges are a Markov process of two states with a time constant of `time` s.
        """
        chance = -0.5 * np.expm1(-2 * self.elapsed / time)
        if not chance > 0:
            return self
        other = self.take(np.arange(min(EXCHANGES, len(self.log_weights)))).exchanged()
        kept = self.log_weights.copy()
        kept[:EXCHANGES] += np.log1p(-chance)
        other = replace(other, log_weights=other.log_weights + np.log(chance))
        return replace(self, log_weights=kept).joined(other)

    def joined(self, other: Self) -> Self:
        """Concatenate the hypotheses of both."""
        both: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("log_weights", *OF_PARTS)
        }
        return replace(self, **both, clutter=self.clutter.joined([other.clutter]))

    def reduced(self, radius: float) -> Self:
        """Keep the best hypotheses, best first, and merge those that are alike.

        They are alike if all parts are within a fraction of their standard deviations, or of the `radius` px
        of a hand.
        """
        order = np.argsort(-self.log_weights, kind="stable")
        places, covariances = self.means[order, :, :2], self.covariances[order, :, :2, :2]
        log_weights = self.log_weights[order]
        size = np.sqrt(0.5 * np.trace(covariances, axis1=-2, axis2=-1))
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        ratio = size[:, None] / size
        close = apart < np.maximum(ALIKE * radius, ALIKE * np.minimum(size[:, None], size))
        same = (close & (ratio < 2) & (ratio > 0.5)).all(axis=2)
        kept: list[int] = []
        into: dict[int, list[float]] = {}
        least = log_weights[0] + np.log(LEAST_WEIGHT)
        for one in range(len(order)):
            if log_weights[one] < least:
                break
            twins = [other for other in kept if same[other, one]]
            if twins:
                into[twins[0]].append(log_weights[one])
            elif len(kept) < MOST_HYPOTHESES:
                kept.append(one)
                into[one] = [log_weights[one]]
        sums = np.array([log_sums(np.array(into[one])) for one in kept])
        again = np.argsort(-sums, kind="stable")
        best = self.take(order[np.array(kept)[again]])
        return replace(best, log_weights=sums[again] - log_sums(sums))


HANDS_BELOW = 0.25  # of an arm's length: how far below the shoulder hands are in the middle


def lost_parts(
    body: UpperBody, size: tuple[int, int], speeds: Array, heads: MovingParts, trust: Array
) -> MovingParts:
    """Return the prior of parts that are lost, `(H, 3)`: a head in the image, hands in reach of it.

    Positions have the moments of a uniform distribution over the image, and over a disc.

    `size` `(height, width)` px of the image; `speeds` `(3,)` px/s, standard deviations of velocities;
    `heads`, `trust` `(H,)`: heads, and the probabilities that they are there.
    """
    height, width = size
    means, covariances = np.zeros((len(trust), 3, 4)), np.zeros((len(trust), 3, 4, 4))
    covariances[..., 2:, 2:] = (speeds**2)[:, None, None] * np.eye(2)
    means[:, HEAD, :2] = middle = np.array([0.5 * width, 0.5 * height])
    covariances[:, HEAD, :2, :2] = picture = np.diag([width**2, height**2]) / 12
    off = heads.means[:, :2] - middle
    head = middle + trust[:, None] * off
    trust = trust[:, None, None]
    of_head = trust * heads.covariances[:, :2, :2] + (1 - trust) * picture
    of_head = of_head + trust * (1 - trust) * off[:, :, None] * off[:, None]
    reach = body.upper_arm + body.forearm
    # The person's own left is on the right of the picture.
    means[:, HANDS, 0] = head[:, :1] + np.array([0.5, -0.5]) * body.shoulder_width
    means[:, HANDS, 1] = head[:, 1:] + body.neck + HANDS_BELOW * reach
    covariances[:, HANDS, :2, :2] = (of_head + 0.25 * reach**2 * np.eye(2))[:, None]
    return MovingParts(means, covariances)


def within_reach(tracks: FleshTracks, lost: MovingParts) -> FleshTracks:
    """Replace the parts that are less certain than the prior of `lost` ones by that prior."""
    own, reach = (np.linalg.det(each.covariances[..., :2, :2]) for each in (tracks, lost))
    forgotten = (own > reach)[..., None]
    return replace(
        tracks,
        means=np.where(forgotten, lost.means, tracks.means),
        covariances=np.where(forgotten[..., None], lost.covariances, tracks.covariances),
    )
