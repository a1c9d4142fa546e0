"""State of the tracker of head and hands: hypotheses of which thing was which part all along."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.numerics.densities import log_sums
from .clutter import Clutter

Array = NDArray[np.float64]

HEAD, LEFT, RIGHT = range(3)
HANDS = [LEFT, RIGHT]
EXCHANGED = [HEAD, RIGHT, LEFT]

MOST_HYPOTHESES = 16

EXCHANGES = 4
"""Hypotheses, the best ones, whose hands are exchanged now and then."""

ALIKE = 0.6
"""Of a hand's radius, or of a standard deviation: places that are so close are the same."""

LEAST_WEIGHT = 1e-5
"""Of the best hypothesis: with less, one is given up."""


@short_repr
@dataclass(frozen=True, eq=False)
class FleshTracks:
    """Weighted hypotheses of head, left hand and right hand, in each of which parts are Gaussians.

    Parameters
    ----------
    size
        `(height, width)` px of the picture.
    patience
        s after which a part that is not confirmed is lost.
    log_weights
        `(H,)`, of weights that sum to 1; the best one first.
    means
        `(H, 3, 4)`: x, y px and their velocities px/s.
    covariances
        `(H, 3, 4, 4)`, in the same order.
    visible
        `(H, 3)`: probability that a part is not hidden just now.
    since
        `(H, 3)` s since a part was last confirmed by a detection; infinite before the first time.
    things
        `(H, 3)` int64: number of the detection in the last picture that a part was, or was hidden by; -1 for
        none.
    clutter
        what else there is.
    elapsed
        s since the last update.
    """

    size: tuple[int, int]
    patience: float
    log_weights: Array
    means: Array
    covariances: Array
    visible: Array
    since: Array
    things: NDArray[np.int64]
    clutter: Clutter
    elapsed: float = 0.0

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
        return replace(
            self,
            log_weights=self.log_weights[hypotheses],
            means=self.means[hypotheses],
            covariances=self.covariances[hypotheses],
            visible=self.visible[hypotheses],
            since=self.since[hypotheses],
            things=self.things[hypotheses],
            clutter=self.clutter.take(hypotheses),
        )

    def exchanged(self) -> Self:
        """The same with each hand where the other one is."""
        return replace(
            self,
            means=self.means[:, EXCHANGED],
            covariances=self.covariances[:, EXCHANGED],
            visible=self.visible[:, EXCHANGED],
            since=self.since[:, EXCHANGED],
            things=self.things[:, EXCHANGED],
        )

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
        clutter = Clutter(
            np.concatenate([self.clutter.places, other.clutter.places]),
            np.concatenate([self.clutter.variances, other.clutter.variances]),
            np.concatenate([self.clutter.chances, other.clutter.chances]),
        )
        return replace(
            self,
            log_weights=np.concatenate([self.log_weights, other.log_weights]),
            means=np.concatenate([self.means, other.means]),
            covariances=np.concatenate([self.covariances, other.covariances]),
            visible=np.concatenate([self.visible, other.visible]),
            since=np.concatenate([self.since, other.since]),
            things=np.concatenate([self.things, other.things]),
            clutter=clutter,
        )

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
