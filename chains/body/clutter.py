"""Things in the colour of skin that are nobody: they were there before, and stay."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr

Array = NDArray[np.float64]

MOST_CLUTTER = 12
"""Things that are kept: as many as a picture may show."""

FOUND = 0.9
"""Chance that one that is there is detected."""

LASTS = 20.0
"""s for which one stays."""

BORN = 0.3
"""Chance that something which is seen once, and is no part, stays."""

LEAST_KNOWN = 1e-9
"""Probability: of something new."""

SUREST = 0.99
"""However often it was seen, it may have gone since then."""


@short_repr
@dataclass(frozen=True, eq=False)
class Clutter:
    """Things at rest under each of H hypotheses, which keep numbers of their own.

    Parameters
    ----------
    places
        `(H, n, 2)` px.
    variances
        `(H, n)` px^2, along each axis.
    chances
        `(H, n)`: probability that the thing is still there; 0 of none.
    """

    places: Array
    variances: Array
    chances: Array

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

    def take(self, hypotheses: NDArray[np.intp]) -> Self:
        """Those of some hypotheses."""
        return type(self)(self.places[hypotheses], self.variances[hypotheses], self.chances[hypotheses])


@dataclass(frozen=True, eq=False)
class ClutterMatch:
    """Which things in a picture are which clutter, under each hypothesis, if they are no part of the body.

    Parameters
    ----------
    clutter
        before the picture.
    means, variances
        `(k, 2)` px and `(k,)` px^2 of the things in the picture.
    new
        `(k,)`: whether a thing may be clutter.
    pairs
        `(H, k)`: number of the clutter, -1 for something new.
    gains
        `(H, k)` nats: how much more probable the thing is as that clutter than as something new; 0 for that.
    """

    clutter: Clutter
    means: Array
    variances: Array
    new: NDArray[np.bool_]
    pairs: NDArray[np.intp]
    gains: Array

    @classmethod
    def of(cls, clutter: Clutter, means: Array, variances: Array, densities: Array, jitter: float) -> Self:
        """Things and clutter that fit each other best.

        Parameters
        ----------
        densities
            `(k,)` of something new, per px^2; infinite for what is never clutter.
        jitter
            px, standard deviation with which clutter is found again.
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

    @cached_property
    def log_missed(self) -> Array:
        """`(H, n)` nats: that a piece of clutter is not detected."""
        return np.log1p(-FOUND * self.clutter.chances)

    @property
    def log_absent(self) -> Array:
        """`(H,)` nats: that all clutter is missed to which nothing in the picture corresponds."""
        return np.asarray(np.where(self._found, 0.0, self.log_missed).sum(axis=1))

    @property
    def log_known(self) -> Array:
        """`(H, k)` nats of `known`, `LEAST_KNOWN` at least."""
        return np.asarray(np.log(np.maximum(self.known, LEAST_KNOWN)))

    @property
    def known(self) -> Array:
        """`(H, k)`: probability that a thing, if it is no part, was there before."""
        return np.where(self.pairs >= 0, 1 / (1 + np.exp(-self.gains)), 0.0)

    @cached_property
    def _found(self) -> NDArray[np.bool_]:
        """`(H, n)`."""
        return np.asarray((self.pairs[:, :, None] == np.arange(self.clutter.chances.shape[1])).any(axis=1))

    def updated(self, hypotheses: NDArray[np.intp], parts: Array, radius: float) -> Clutter:
        """Clutter after the picture for some continuations of hypotheses.

        What a part is, or what is within a `radius` of it, is not clutter; clutter there is covered.

        Parameters
        ----------
        hypotheses
            `(m,)`, which each of them continues.
        parts
            `(m, n_parts, 2)` px: where parts are seen; not a number for one that is not.
        """
        before, pairs = self.clutter.take(hypotheses), self.pairs[hypotheses]
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
        everything = Clutter(
            np.concatenate([places, np.broadcast_to(self.means, (*new.shape, 2))], axis=1),
            np.concatenate([variances, np.broadcast_to(self.variances, new.shape)], axis=1),
            np.concatenate([chances, new], axis=1),
        )
        kept = np.argsort(-everything.chances, axis=1, kind="stable")[:, :MOST_CLUTTER]
        return Clutter(
            everything.places[rows, kept], everything.variances[rows, kept], everything.chances[rows, kept]
        )


def _near(places: Array, parts: Array, radius: float) -> NDArray[np.bool_]:
    """`(m, n)`: whether `places` `(m, n, 2)` are within a radius of any of `parts` `(m, n_parts, 2)`."""
    squares = ((places[:, :, None] - parts[:, None]) ** 2).sum(axis=-1)
    return np.asarray((squares < radius**2).any(axis=2))
