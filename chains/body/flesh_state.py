"""State of the flesh tracker: hypotheses of which blob was which part, clutter, and the reach of hands."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import UpperBody
from ...models.core.gaussian_mixtures import log_sums
from ...models.core.short_repr import Rows, short_repr
from .flesh_assignment import MovingParts

Array = NDArray[np.float64]

MOST_CLUTTER = 12  # things that are kept: as many as a picture may show
FOUND = 0.9  # chance that one that is there is detected
LASTS = 20.0  # s for which one stays
BORN = 0.3  # chance that something which is seen once, and is no part, stays
LEAST_KNOWN = 1e-9  # probability: of something new
SUREST = 0.99  # however often it was seen, it may have gone since then


@short_repr
@dataclass(frozen=True, eq=False)
class Clutter(Rows):
    """Things at rest under each of H hypotheses, which keep numbers of their own."""

    places: Array  # `(H, n, 2)` px
    variances: Array  # `(H, n)` px^2, along each axis
    chances: Array  # `(H, n)`: probability that the thing is still there; 0 of none

    @classmethod
    def none(cls, n_hypotheses: int) -> Self:
        """Nothing is known of any."""
        shape = (n_hypotheses, 0)
        return cls(np.zeros((*shape, 2)), np.ones(shape), np.zeros(shape))

    def moved(self, dt: float, drift: float) -> Self:
        """`dt` s later; `drift` is in px a root of a second."""
        return replace(
            self, variances=self.variances + drift**2 * dt, chances=self.chances * np.exp(-dt / LASTS)
        )


@dataclass(frozen=True, eq=False)
class ClutterMatch:
    """Which things in a picture are which clutter, under each hypothesis, if they are no part of the body."""

    clutter: Clutter  # before the picture
    # `(k, 2)` px and `(k,)` px^2 of the things in the picture
    means: Array
    variances: Array
    new: NDArray[np.bool_]  # `(k,)`: whether a thing may be clutter
    pairs: NDArray[np.intp]  # `(H, k)`: number of the clutter, -1 for something new
    # `(H, k)` nats: how much more probable the thing is as that clutter than as something new; 0 for that
    gains: Array

    @classmethod
    def of(cls, clutter: Clutter, means: Array, variances: Array, densities: Array, jitter: float) -> Self:
        """Things and clutter that fit each other best.

        `densities` `(k,)` of something new, per px^2; infinite for what is never clutter; `jitter` px,
        standard deviation with which clutter is found again.
        """
        n_hypotheses, n_clutter = clutter.chances.shape
        new = np.isfinite(densities)
        if not n_clutter or not len(means):
            none = np.full((n_hypotheses, len(means)), -1)
            return cls(clutter, means, variances, new, none, np.zeros(none.shape))
        spread = clutter.variances[:, :, None] + variances + jitter**2
        squares = ((clutter.places[:, :, None] - means) ** 2).sum(axis=-1)
        with np.errstate(divide="ignore"):
            there = np.log(FOUND * clutter.chances)[:, :, None]
        gains = there - np.log(2 * np.pi * spread * densities) - 0.5 * squares / spread
        best = gains.argmax(axis=1)
        mutual = np.take_along_axis(gains.argmax(axis=2), best, 1) == np.arange(len(means))
        gain = np.take_along_axis(gains, best[:, None], 1)[:, 0]
        paired = mutual & (gain > 0)
        return cls(clutter, means, variances, new, np.where(paired, best, -1), np.where(paired, gain, 0.0))

    @property
    def log_absent(self) -> Array:
        """`(H,)` nats: that all clutter is missed to which nothing in the picture corresponds."""
        found = (self.pairs[:, :, None] == np.arange(self.clutter.chances.shape[1])).any(axis=1)
        return np.asarray(np.where(found, 0.0, np.log1p(-FOUND * self.clutter.chances)).sum(axis=1))

    @property
    def log_known(self) -> Array:
        """`(H, k)` nats of `known`, `LEAST_KNOWN` at least."""
        return np.asarray(np.log(np.maximum(self.known, LEAST_KNOWN)))

    @property
    def known(self) -> Array:
        """`(H, k)`: probability that a thing, if it is no part, was there before."""
        return np.where(self.pairs >= 0, 1 / (1 + np.exp(-self.gains)), 0.0)

    def updated(self, hypotheses: NDArray[np.intp], parts: Array, radius: float) -> Clutter:
        """Clutter after the picture for some continuations of hypotheses.

        What a part is, or what is within a `radius` of it, is not clutter; clutter there is covered.

        `hypotheses` `(m,)`, which each of them continues; `parts` `(m, n_parts, 2)` px: where parts are seen;
        not a number for one that is not.
        """
        before, pairs = self.clutter.only(hypotheses), self.pairs[hypotheses]
        taken = _near(self.means[None], parts, radius)
        rows = np.arange(len(hypotheses))[:, None]
        places, variances, chances = before.places.copy(), before.variances.copy(), before.chances.copy()
        covered = _near(places, parts, radius)
        gone = chances * (1 - FOUND) / (1 - FOUND * chances)
        chances = np.where(covered, chances, gone)
        row, thing = np.nonzero((pairs >= 0) & ~taken)
        found = pairs[row, thing]
        share = variances[row, found] / (variances[row, found] + self.variances[thing])
        places[row, found] += share[:, None] * (self.means[thing] - places[row, found])
        variances[row, found] *= 1 - share
        chances[row, found] = np.minimum(self.known[hypotheses][row, thing], SUREST)
        new = np.where((pairs < 0) & ~taken & self.new, BORN, 0.0)
        shape = new.shape
        seen = np.broadcast_to(self.means, (*shape, 2)), np.broadcast_to(self.variances, shape), new
        both = zip((places, variances, chances), seen, strict=True)
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
OF_PARTS = ("means", "covariances", "visible", "since", "things")

MOST_HYPOTHESES = 16

EXCHANGES = 4  # hypotheses, the best ones, whose hands are exchanged now and then
ALIKE = 0.6  # of a hand's radius, or of a standard deviation: places that are so close are the same
LEAST_WEIGHT = 1e-5  # of the best hypothesis: with less, one is given up


@short_repr
@dataclass(frozen=True, eq=False)
class FleshTracks:
    """Weighted hypotheses of head, left hand and right hand, in each of which parts are Gaussians."""

    size: tuple[int, int]  # `(height, width)` px of the picture
    patience: float  # s after which a part that is not confirmed is lost
    log_weights: Array  # `(H,)`, of weights that sum to 1; the best one first
    means: Array  # `(H, 3, 4)`: x, y px and their velocities px/s
    covariances: Array  # `(H, 3, 4, 4)`, in the same order
    visible: Array  # `(H, 3)`: probability that a part is not hidden just now
    since: Array  # `(H, 3)` s since a part was last confirmed by a detection; infinite before the first time
    things: NDArray[np.int64]  # `(H, 3)`: number of the detection that a part was, or was hidden by, or -1
    clutter: Clutter  # what else there is
    elapsed: float = 0.0  # s since the last update

    @cached_property
    def weights(self) -> Array:
        """`(H,)`, with sum 1."""
        return np.exp(self.log_weights)

    @property
    def trust(self) -> Array:
        """`(H, 3)`: probability that a part has not jumped since it was last seen."""
        return np.exp(-self.since / self.patience)

    @property
    def positions(self) -> Array:
        """`(3, 2)` px, under the best hypothesis."""
        return np.asarray(self.means[0, :, :2])

    @property
    def position_covariances(self) -> Array:
        """`(3, 2, 2)` px^2: second moments of all hypotheses about these positions."""
        apart = self.means[..., :2] - self.positions
        scatter = self.covariances[..., :2, :2] + apart[..., :, None] * apart[..., None, :]
        return np.asarray(np.einsum("h,hpxy->pxy", self.weights, scatter))

    @property
    def unseen(self) -> Array:
        """`(3,)` s since a part was last confirmed, under the best hypothesis."""
        return np.asarray(self.since[0])

    @property
    def labels(self) -> NDArray[np.int64]:
        """`(3,)` detections that parts are under the best hypothesis, -1 for none."""
        return np.asarray(self.things[0])

    @property
    def lost(self) -> NDArray[np.bool_]:
        """`(3,)`: parts that may be anywhere in reach, since nothing has confirmed them for too long."""
        return np.asarray(self.unseen > self.patience)

    def take(self, hypotheses: NDArray[np.intp]) -> Self:
        """Some of the hypotheses, with their weights."""
        rows: dict[str, Any] = {name: getattr(self, name)[hypotheses] for name in ("log_weights", *OF_PARTS)}
        return replace(self, **rows, clutter=self.clutter.only(hypotheses))

    def exchanged(self) -> Self:
        """The same with each hand where the other one is."""
        return replace(self, **{name: getattr(self, name)[:, EXCHANGED] for name in OF_PARTS})

    def exchanged_now_and_then(self, time: float) -> Self:
        """With some more hypotheses, in which the hands were exchanged since the last update.

        Whether they were is forgotten with a time constant of `time` s.
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
        """The hypotheses of both."""
        both: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("log_weights", *OF_PARTS)
        }
        return replace(self, **both, clutter=self.clutter.joined([other.clutter]))

    def reduced(self, radius: float) -> Self:
        """The best hypotheses, best first; one that says the same as a better one is merged into that.

        They say the same if all parts are within a fraction of what is known of them, or of the `radius` px
        of a hand.
        """
        order = np.argsort(-self.log_weights, kind="stable")
        places, spreads = self.means[order, :, :2], self.covariances[order, :, :2, :2]
        log_weights = self.log_weights[order]
        size = np.sqrt(0.5 * np.trace(spreads, axis1=-2, axis2=-1))
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


def anywhere(
    body: UpperBody, size: tuple[int, int], speeds: Array, heads: MovingParts, trust: Array
) -> MovingParts:
    """A head in the picture, hands in reach of their shoulders: `(H, 3)`.

    Positions have the moments of a uniform distribution over the picture, and over a disc.

    `size` `(height, width)` px of the picture; `speeds` `(3,)` px/s, standard deviations of velocities;
    `heads`, `trust` `(H,)` heads, and the probabilities that they are there.
    """
    height, width = size
    means, covariances = np.zeros((len(trust), 3, 4)), np.zeros((len(trust), 3, 4, 4))
    covariances[..., 2:, 2:] = (speeds**2)[:, None, None] * np.eye(2)
    means[:, HEAD, :2] = middle = np.array([0.5 * width, 0.5 * height])
    covariances[:, HEAD, :2, :2] = picture = np.diag([width**2, height**2]) / 12
    off = heads.means[:, :2] - middle
    head = middle + trust[:, None] * off
    trust = trust[:, None, None]
    spread = trust * heads.covariances[:, :2, :2] + (1 - trust) * picture
    spread = spread + trust * (1 - trust) * off[:, :, None] * off[:, None]
    reach = body.upper_arm + body.forearm
    # The person's own left is on the right of the picture.
    means[:, HANDS, 0] = head[:, :1] + np.array([0.5, -0.5]) * body.shoulder_width
    means[:, HANDS, 1] = head[:, 1:] + body.neck + HANDS_BELOW * reach
    covariances[:, HANDS, :2, :2] = (spread + 0.25 * reach**2 * np.eye(2))[:, None]
    return MovingParts(means, covariances)


def within_reach(tracks: FleshTracks, lost: MovingParts) -> FleshTracks:
    """The same, in which a part of which less is known than that it is in reach may be `lost` there."""
    own, reach = (np.linalg.det(each.covariances[..., :2, :2]) for each in (tracks, lost))
    forgotten = (own > reach)[..., None]
    return replace(
        tracks,
        means=np.where(forgotten, lost.means, tracks.means),
        covariances=np.where(forgotten[..., None], lost.covariances, tracks.covariances),
    )
