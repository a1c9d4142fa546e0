"""Assignment of the skin blobs of a frame to head and hands, under each hypothesis of the flesh tracker.

Parts move with constant velocity in the picture. The scores of an assignment also hold what else speaks for
a blob being a part: sides, other blobs about it, other chains.
"""

from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...inference.kalman import ornstein_uhlenbeck_velocity
from ...models.body.parts import PartMessage
from ...models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures, log_sums, products
from ...models.core.short_repr import Rows

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, eq=False)
class MovingParts(Rows):
    """Gaussians over position and velocity in the picture, any number of them."""

    means: Array  # `(..., 4)`: x, y px and their velocities px/s
    covariances: Array  # `(..., 4, 4)`, in the same order, positive definite

    def moved(self, dt: float, speeds: ArrayLike, velocity_time: float) -> Self:
        """Parts `dt` s later, whose velocities are Ornstein-Uhlenbeck processes; exact for any `dt`.

        `dt`: s; `speeds` `(...)` px/s, standard deviation of a velocity's components in the long run;
        `velocity_time` s, time constant of velocities.
        """
        motion = ornstein_uhlenbeck_velocity(dt, velocity_time).along(2)
        return type(self)(*motion.moved(self.means, self.covariances, np.square(speeds)))

    def given(self, positions: Array, spreads: Array) -> Self:
        """The same if the positions have these means `(..., 2)` px and covariances `(..., 2, 2)` px^2.

        The velocity is a regression on the position and an independent rest, so that covariances are sums of
        positive ones: they stay positive definite however sure a position is.
        """
        spread, cross = self.covariances[..., :2, :2], self.covariances[..., 2:, :2]
        slope = cross @ np.linalg.inv(spread)
        rest = _symmetric(self.covariances[..., 2:, 2:] - slope @ cross.swapaxes(-1, -2))
        lift = np.concatenate([np.broadcast_to(np.eye(2), slope.shape), slope], axis=-2)
        means = self.means + (lift @ (positions - self.means[..., :2])[..., None])[..., 0]
        covariances = lift @ spreads @ lift.swapaxes(-1, -2)
        covariances[..., 2:, 2:] += rest
        return type(self)(means, _symmetric(covariances))


def _symmetric(matrices: Array) -> Array:
    return 0.5 * (matrices + matrices.swapaxes(-1, -2))


VISIBLE = 0.85  # share of the time in which a part is not hidden
MOST_FOUND = 0.98  # chance that a part which is not hidden is detected, at most
LEAST_FOUND = 1e-9  # the same at least, where things may be the part: ratios are over it
COVERED = 0.9  # chance that a part is not seen on its own where another thing is
CHOICES = 8  # answers for each part that are combined with those for the others
CANDIDATES = 64  # joint answers that are worked out
NEVER = -1e9  # nats: finite, so that sums of it are numbers


@dataclass(frozen=True, eq=False)
class Things:
    """What is detected in a picture."""

    labels: NDArray[np.int64]  # `(k,)` int64
    # `(k, 2)` px, `(k, 2, 2)` px^2
    means: Array
    covariances: Array
    # `(n_parts, k)` nats: how much more probable a thing is if it is a part right there, than anything else
    # in the picture's area; minus infinity if it cannot be the part. Per px^-2.
    log_ratios: Array
    found: Array  # `(n_parts,)`: chance that a part is detected

    @property
    def chances(self) -> Array:
        """`(n_parts,)`: that a part is detected which is not hidden."""
        return np.asarray(np.minimum(self.found / VISIBLE, MOST_FOUND))

    def take(self, parts: list[int]) -> Self:
        """The same for some of the parts."""
        return replace(self, log_ratios=self.log_ratios[parts], found=self.found[parts])

    @classmethod
    def of(cls, detections: GaussianMixtures | None, n_parts: int) -> Self:
        """What mixtures over the parts' places tell, whose flat components are misses."""
        if detections is None or not detections.informative.any():
            return cls(
                np.zeros(0, np.int64),
                np.zeros((0, 2)),
                np.zeros((0, 2, 2)),
                np.zeros((n_parts, 0)),
                np.zeros(n_parts),
            )
        weights = np.where(detections.flat, -np.inf, detections.log_weights)
        missed = np.exp(log_sums(np.where(detections.flat, detections.log_weights, -np.inf)))
        found = np.where(detections.informative, np.clip(1 - missed, LEAST_FOUND, 1.0), 0.0)
        there = np.isfinite(weights)
        labels, first = np.unique(detections.labels[there], return_index=True)
        same = there[:, None] & (detections.labels[:, None] == labels[:, None])
        ratios = log_sums(np.where(same, weights[:, None], -np.inf))
        ratios -= np.log(np.maximum(found, LEAST_FOUND))[:, None]
        return cls(
            labels, detections.means[there][first], detections.covariances[there][first], ratios, found
        )


@dataclass(frozen=True, eq=False)
class PartOptions:
    """What each part may be under each of H hypotheses, and where it is then.

    With k things, options are: each of them, not seen, hidden where each of them is.
    """

    log_masses: Array  # `(H, n_parts, 2k + 1)` nats
    shares: Array  # `(H, n_parts, 2, 2k + 1)`: probability that a part went on, or is elsewhere in reach
    # `(H, n_parts, 2, 2k + 1, 2)` px and `(..., 2, 2)` px^2 in these cases
    means: Array
    covariances: Array

    @classmethod
    def of(
        cls,
        went_on: MovingParts,
        elsewhere: MovingParts,
        trust: Array,
        visible: Array,
        things: Things,
        radii: Array,
    ) -> Self:
        """All of them.

        `went_on`, `elsewhere`: predictions `(H, n_parts)`; `trust`, `visible` `(H, n_parts)`: probabilities
        that the first holds, and that a part is not hidden; `radii` `(k,)` px: standard deviations of
        Gaussian windows in which a part is hidden by a thing.
        """
        n_hypotheses, n_parts = trust.shape
        k = len(things.labels)
        n_rows, n_options = n_hypotheses * n_parts, 2 * k + 1
        prior_means = np.stack([each.means[..., :2] for each in (went_on, elsewhere)], axis=2)
        prior_spreads = np.stack([each.covariances[..., :2, :2] for each in (went_on, elsewhere)], axis=2)
        hides = radii[:, None, None] ** 2 * np.eye(2)
        places = np.concatenate([things.means, np.zeros((1, 2)), things.means])
        spreads = np.concatenate([things.covariances, np.eye(2)[None], hides])
        flat = np.arange(n_options) == k
        rows = (n_rows, n_options)
        means, covariances = np.empty((n_rows, 2 * n_options, 2)), np.empty((n_rows, 2 * n_options, 2, 2))
        overlaps = np.empty((n_rows, 2 * n_options))
        products(
            prior_means.reshape(n_rows, 2, 2), prior_spreads.reshape(n_rows, 2, 2, 2),
            np.zeros((n_rows, 2), np.bool_),
            np.broadcast_to(places, (*rows, 2)).copy(), np.broadcast_to(spreads, (*rows, 2, 2)).copy(),
            np.broadcast_to(flat, rows).copy(), means, covariances, overlaps,
        )  # fmt: skip
        shape = (n_hypotheses, n_parts, 2, n_options)
        with np.errstate(divide="ignore"):
            cases = np.log(np.stack([trust, 1 - trust], axis=2))[..., None] + overlaps.reshape(shape)
            seen = np.log(visible * things.chances)
            missed = np.log1p(-visible * things.chances)
        # somebody who is not seen goes on: elsewhere he would be anywhere
        cases[..., 0, k], cases[..., 1, k] = 0.0, -np.inf
        masses = log_sums(cases, axis=2)
        shares = np.exp(cases - np.where(np.isfinite(masses), masses, 0.0)[:, :, None])
        masses[..., :k] += seen[..., None] + things.log_ratios
        masses[..., k] += missed
        masses[..., k + 1 :] += np.log(2 * np.pi * radii**2 * COVERED)
        return cls(
            np.maximum(masses, NEVER), shares, means.reshape(*shape, 2), covariances.reshape(*shape, 2, 2)
        )


@dataclass(frozen=True, eq=False)
class Answers:
    """Joint answers for all parts, each of a hypothesis."""

    hypotheses: Numbers  # `(m,)`
    options: Numbers  # `(m, n_parts)`
    log_masses: Array  # `(m,)` nats

    @classmethod
    def best(
        cls,
        log_hypotheses: Array,
        log_masses: Array,
        log_known: Array,
        gains: Array,
        beside: Array,
        same: NDArray[np.bool_],
    ) -> Self:
        """The `CANDIDATES` most probable ones.

        A thing is one part's image. Where a part is hidden by a thing, that is another part, or was there
        before.

        `log_hypotheses` `(H,)`; `log_masses` `(H, n_parts, 2k + 1)` as in `PartOptions`, three parts;
        `log_known` `(H, k)` nats: that a thing which is no part was there before; `gains` `(H, k)` nats: how
        much more probable it is as such than as something new; `beside` `(n_parts, k, k)`: of a part that is
        one thing, the same for another one as more of that part; `same` `(k, k)`: things that are too close
        to be two parts.
        """
        n_hypotheses, n_parts, n_options = log_masses.shape
        k = n_options // 2
        n = min(CHOICES, n_options)
        options = np.argsort(-log_masses, axis=2, kind="stable")[..., :n]
        thing = np.where(options <= k, options, options - k - 1)
        which = np.where(options < k, options, k)  # a thing that the part itself is, k for none
        known = np.pad(log_known, ((0, 0), (0, 1)))[np.arange(n_hypotheses)[:, None, None], thing]
        alone = np.where(options > k, known, 0.0)
        either = np.pad(same | np.eye(k, dtype=np.bool_), (0, 1))
        beside = np.pad(beside, ((0, 0), (0, 1), (0, 0)))

        def along(values: NDArray[T], part: int) -> NDArray[T]:
            """Of one part, on its axis of `(H, n, n, n)`."""
            return values[:, part].reshape(
                n_hypotheses, *(n if axis == part else 1 for axis in range(n_parts))
            )

        total = log_hypotheses.reshape(-1, *n_parts * [1])
        values = np.take_along_axis(log_masses, options, 2)
        explained = 1 + np.where(gains > 0, np.exp(gains), 0.0).reshape(n_hypotheses, *n_parts * [1], k)
        used = np.zeros(1, np.bool_)
        for part in range(n_parts):
            own = along(which, part)
            behind = np.zeros(1, np.bool_)
            for other in range(n_parts):
                if other != part:
                    behind = behind | ((along(thing, part) == along(which, other)) & (along(thing, part) < k))
                if other > part:
                    total = total + np.where(either[own, along(which, other)], NEVER, 0.0)
            total = total + along(values, part) + np.where(behind, 0.0, along(alone, part))
            explained = explained + beside[part][own]
            used = used | (own[..., None] == np.arange(k))
        total = (total + np.where(used, 0.0, np.log(explained)).sum(axis=-1)).ravel()
        m = min(CANDIDATES, len(total))
        top = np.argpartition(-total, m - 1)[:m]
        top = top[np.argsort(-total[top], kind="stable")]
        top = top[total[top] > 0.5 * NEVER]
        hypotheses, *chosen = np.unravel_index(top, (n_hypotheses, *n_parts * [n]))
        picked = np.stack([options[hypotheses, part, chosen[part]] for part in range(n_parts)], axis=1)
        return cls(hypotheses, picked, total[top])

    def parts(self, options: PartOptions, went_on: MovingParts, elsewhere: MovingParts) -> MovingParts:
        """`(m, n_parts)`: where the parts are then, and how they move."""
        rows, columns = self.hypotheses[:, None], np.arange(self.options.shape[1])
        shares, means, covariances = [], [], []
        for case, prior in enumerate((went_on, elsewhere)):
            here = (rows, columns, case, self.options)
            moved = prior.only(self.hypotheses).given(options.means[here], options.covariances[here])
            shares.append(options.shares[here])
            means.append(moved.means)
            covariances.append(moved.covariances)
        share = np.stack(shares)[..., None]
        mean = (share * np.stack(means)).sum(axis=0)
        apart = np.stack(means) - mean
        scatter = np.stack(covariances) + apart[..., :, None] * apart[..., None, :]
        return MovingParts(mean, (share[..., None] * scatter).sum(axis=0))

    def labels(self, things: Things) -> NDArray[np.int64]:
        """`(m, n_parts)`: labels of the things that parts are, or are hidden by; -1 for none."""
        k = len(things.labels)
        padded = np.append(things.labels, NO_LABEL)
        return np.asarray(padded[np.where(self.options <= k, self.options, self.options - k - 1)])


LOOKS_APART = 1.0  # s, after which it is a new look that hands are on their own sides


def log_sides(right: Array, since: Array, shoulder_width: float) -> Array:
    """`(H, 2, k)` nats: things as left and right hand, by the side on which they are.

    A hand is before its own shoulder, give or take half of their distance. As a hand stays where it is, the
    same look again counts only as far as it was forgotten.

    `right` `(H, k)` px: how far things are to the right of the head; `since` `(H, 2)` s since the hands were
    seen; `shoulder_width`: px.
    """
    odds = right * 4 / shoulder_width
    own = np.log(2) - np.logaddexp(0.0, np.stack([-odds, odds], axis=1))
    return np.asarray(-np.expm1(-since[:, :, None] / LOOKS_APART) * own)


def ratios_beside(places: Array, radii: Array, number: float, densities: Array) -> Array:
    """`(n_parts, k, k)`: of a part that is one thing, how much more probable another is as more of that part.

    `places` `(k, 2)` px of things; `radii` `(n_parts,)` px: standard deviations of other things of a part
    about it; `number`: of these, on average; `densities` `(k,)` of something new there, per px^2.
    """
    squares = ((places[:, None] - places) ** 2).sum(axis=2)
    width = radii[:, None, None] ** 2
    return np.asarray(number / (2 * np.pi * width * densities) * np.exp(-0.5 * squares / width))


def log_overlaps(options: PartOptions, message: PartMessage) -> Array:
    """`(H, 3, n)` nats: how well each part's options fit what chains say of it, whatever other parts are."""
    shape = options.shares.shape
    means, covariances = (
        values.swapaxes(0, 1).reshape(shape[1], -1, *values.shape[4:])
        for values in (options.means, options.covariances)
    )
    overlaps = message.predicted.log_overlaps(means, covariances)
    overlaps = overlaps.reshape(shape[1], shape[0], *shape[2:]).swapaxes(0, 1)
    with np.errstate(divide="ignore"):
        return log_sums(overlaps + np.log(options.shares), axis=2)


def log_joint_overlaps(parts: MovingParts, message: PartMessage) -> Array:
    """`(m,)` nats: log of the integral of what chains say times Gaussians of all parts, `(m, 3)`."""
    n = len(message.log_hypotheses)
    means = np.tile(parts.means[..., :2].swapaxes(0, 1), (n, 1, 1))
    covariances = np.tile(parts.covariances[..., :2, :2].swapaxes(0, 1), (n, 1, 1, 1))
    overlaps = message.stacked.log_overlaps(means, covariances).reshape(n, 3, -1).sum(axis=1)
    return log_sums(overlaps + message.log_hypotheses[:, None], axis=0)
