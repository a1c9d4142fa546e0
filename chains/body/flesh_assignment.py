"""Data association of the flesh tracker: skin blobs to head and hands, under each of its hypotheses.

The score of an assignment combines motion, side of the body, blobs beside it, and other chains' messages.
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
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, eq=False)
class MovingParts(Rows):
    """Gaussians over position and velocity in the picture."""

    means: Array  # `(..., 4)`: x, y px and their velocities px/s
    covariances: Array  # `(..., 4, 4)`, in the same order, positive definite

    def predict(self, dt: float, speeds: ArrayLike, velocity_time: float) -> Self:
        """Predict the parts `dt` s ahead; velocities are Ornstein-Uhlenbeck processes, exact for any `dt`.

        `speeds` `(...)` px/s: stationary standard deviation of each component of the velocity;
        `velocity_time` s: its time constant.
        """
        motion = ornstein_uhlenbeck_velocity(dt, velocity_time).along(2)
        return type(self)(*motion.moved(self.means, self.covariances, np.square(speeds)))

    def with_positions(self, positions: Array, position_covariances: Array) -> Self:
        """Replace the marginals of the positions by means `(..., 2)` px and covariances `(..., 2, 2)` px^2.

        The velocity is a regression on the position plus an independent rest, so covariances are sums of
        positive semidefinite ones and stay positive definite.
        """
        prior, cross = self.covariances[..., :2, :2], self.covariances[..., 2:, :2]
        slope = cross @ np.linalg.inv(prior)
        rest = _symmetric(self.covariances[..., 2:, 2:] - slope @ cross.swapaxes(-1, -2))
        lift = np.concatenate([np.broadcast_to(np.eye(2), slope.shape), slope], axis=-2)
        means = self.means + (lift @ (positions - self.means[..., :2])[..., None])[..., 0]
        covariances = lift @ position_covariances @ lift.swapaxes(-1, -2)
        covariances[..., 2:, 2:] += rest
        return type(self)(means, _symmetric(covariances))


def _symmetric(matrices: Array) -> Array:
    return 0.5 * (matrices + matrices.swapaxes(-1, -2))


VISIBLE = 0.85  # stationary probability that a part is not hidden: generated signers hide one for a fifth
MOST_DETECTED = 0.98  # detection probability of a visible part, at most
LEAST_DETECTED = 1e-9  # detection probability at least, which ratios are divided by
COVERED = 0.9  # probability that a part behind or before another detection has none of its own
OPTIONS = 8  # options of each part, the best ones, that are combined with those of the others
ASSIGNMENTS = 64  # joint assignments that are kept
IMPOSSIBLE = -1e9  # nats: finite, so that its sums are numbers


@dataclass(frozen=True, eq=False)
class PartDetections:
    """k detections in an image, each of which may be one of the parts."""

    labels: NDArray[np.int64]  # `(k,)`
    # `(k, 2)` px, `(k, 2, 2)` px^2
    means: Array
    covariances: Array
    # `(n_parts, k)` log likelihood ratio of the detection, px^2: the part is there against clutter anywhere
    # in the image; minus infinity if it cannot be the part
    log_ratios: Array
    probabilities: Array  # `(n_parts,)`: that a part is detected

    @property
    def visible_probabilities(self) -> Array:
        """`(n_parts,)`: probability that a part which is not hidden is detected."""
        return np.asarray(np.minimum(self.probabilities / VISIBLE, MOST_DETECTED))

    def take(self, parts: list[int]) -> Self:
        """Return the detections as candidates of some of the parts."""
        return replace(self, log_ratios=self.log_ratios[parts], probabilities=self.probabilities[parts])

    @classmethod
    def from_mixtures(cls, detections: GaussianMixtures | None, n_parts: int) -> Self:
        """Read the detections from mixtures over the parts' positions, whose flat components are misses."""
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
        detected = np.where(detections.informative, np.clip(1 - missed, LEAST_DETECTED, 1.0), 0.0)
        there = np.isfinite(weights)
        labels, first = np.unique(detections.labels[there], return_index=True)
        same = there[:, None] & (detections.labels[:, None] == labels[:, None])
        ratios = log_sums(np.where(same, weights[:, None], -np.inf))
        ratios -= np.log(np.maximum(detected, LEAST_DETECTED))[:, None]
        return cls(
            labels, detections.means[there][first], detections.covariances[there][first], ratios, detected
        )


@dataclass(frozen=True, eq=False)
class PartOptions:
    """Options of each part under each of H hypotheses, with the posterior of its position.

    With k detections: it is detection 0 to k - 1, it is not seen, it is hidden by detection 0 to k - 1.
    """

    log_masses: Array  # `(H, n_parts, 2k + 1)` nats
    shares: Array  # `(H, n_parts, 2, 2k + 1)`: probability that a part continued, or jumped within reach
    # `(H, n_parts, 2, 2k + 1, 2)` px and `(..., 2, 2)` px^2 in these two cases
    means: Array
    covariances: Array

    @classmethod
    def of(
        cls,
        continued: MovingParts,
        jumped: MovingParts,
        trust: Array,
        visible: Array,
        detections: PartDetections,
        radii: Array,
    ) -> Self:
        """Multiply both predictions with each option.

        `continued`, `jumped`: predictions `(H, n_parts)`; `trust`, `visible` `(H, n_parts)`: probabilities
        that the first one holds, and that a part is not hidden; `radii` `(k,)` px: standard deviations of
        Gaussian windows in which a detection hides a part.
        """
        n_hypotheses, n_parts = trust.shape
        k = len(detections.labels)
        n_rows, n_options = n_hypotheses * n_parts, 2 * k + 1
        prior_means = np.stack([each.means[..., :2] for each in (continued, jumped)], axis=2)
        prior_covariances = np.stack([each.covariances[..., :2, :2] for each in (continued, jumped)], axis=2)
        windows = radii[:, None, None] ** 2 * np.eye(2)
        option_means = np.concatenate([detections.means, np.zeros((1, 2)), detections.means])
        option_covariances = np.concatenate([detections.covariances, np.eye(2)[None], windows])
        flat = np.arange(n_options) == k
        rows = (n_rows, n_options)
        means, covariances = np.empty((n_rows, 2 * n_options, 2)), np.empty((n_rows, 2 * n_options, 2, 2))
        overlaps = np.empty((n_rows, 2 * n_options))
        products(
            prior_means.reshape(n_rows, 2, 2), prior_covariances.reshape(n_rows, 2, 2, 2),
            np.zeros((n_rows, 2), np.bool_),
            np.broadcast_to(option_means, (*rows, 2)).copy(),
            np.broadcast_to(option_covariances, (*rows, 2, 2)).copy(),
            np.broadcast_to(flat, rows).copy(), means, covariances, overlaps,
        )  # fmt: skip
        shape = (n_hypotheses, n_parts, 2, n_options)
        with np.errstate(divide="ignore"):
            cases = np.log(np.stack([trust, 1 - trust], axis=2))[..., None] + overlaps.reshape(shape)
            seen = np.log(visible * detections.visible_probabilities)
            missed = np.log1p(-visible * detections.visible_probabilities)
        # a part that is not seen has continued: there is no position to update a jump with
        cases[..., 0, k], cases[..., 1, k] = 0.0, -np.inf
        masses = log_sums(cases, axis=2)
        shares = np.exp(cases - np.where(np.isfinite(masses), masses, 0.0)[:, :, None])
        masses[..., :k] += seen[..., None] + detections.log_ratios
        masses[..., k] += missed
        masses[..., k + 1 :] += np.log(2 * np.pi * radii**2 * COVERED)
        return cls(
            np.maximum(masses, IMPOSSIBLE),
            shares,
            means.reshape(*shape, 2),
            covariances.reshape(*shape, 2, 2),
        )


@dataclass(frozen=True, eq=False)
class JointAssignments:
    """m joint assignments of all parts, each continuing one hypothesis."""

    hypotheses: NDArray[np.intp]  # `(m,)`
    options: NDArray[np.intp]  # `(m, n_parts)`, as in `PartOptions`
    log_masses: Array  # `(m,)` nats, descending

    @classmethod
    def best(
        cls,
        log_hypotheses: Array,
        log_masses: Array,
        log_old_clutter: Array,
        gains: Array,
        beside: Array,
        same: NDArray[np.bool_],
    ) -> Self:
        """Return the `ASSIGNMENTS` most probable ones.

        A detection is of one part at most. One that hides a part is another part, or clutter that was there
        before.

        `log_hypotheses` `(H,)`; `log_masses` `(H, n_parts, 2k + 1)` as in `PartOptions`, three parts;
        `log_old_clutter` `(H, k)` nats: log probability that a detection of no part is clutter that was there
        before; `gains` `(H, k)` nats: log ratio of old clutter against new; `beside` `(n_parts, k, k)`: the
        ratio of a second detection of the part against new clutter, given the first one; `same` `(k, k)`:
        pairs of detections that are too close to be two parts.
        """
        n_hypotheses, n_parts, n_options = log_masses.shape
        k = n_options // 2
        n = min(OPTIONS, n_options)
        options = np.argsort(-log_masses, axis=2, kind="stable")[..., :n]
        detection = np.where(options <= k, options, options - k - 1)
        which = np.where(options < k, options, k)  # the detection that the part itself is, k for none
        old = np.pad(log_old_clutter, ((0, 0), (0, 1)))[np.arange(n_hypotheses)[:, None, None], detection]
        alone = np.where(options > k, old, 0.0)
        either = np.pad(same | np.eye(k, dtype=np.bool_), (0, 1))
        beside = np.pad(beside, ((0, 0), (0, 1), (0, 0)))

        def along(values: NDArray[T], part: int) -> NDArray[T]:
            """Put the options of a part on its axis of `(H, n, n, n)`."""
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
                    hidden = along(detection, part)
                    behind = behind | ((hidden == along(which, other)) & (hidden < k))
                if other > part:
                    total = total + np.where(either[own, along(which, other)], IMPOSSIBLE, 0.0)
            total = total + along(values, part) + np.where(behind, 0.0, along(alone, part))
            explained = explained + beside[part][own]
            used = used | (own[..., None] == np.arange(k))
        total = (total + np.where(used, 0.0, np.log(explained)).sum(axis=-1)).ravel()
        m = min(ASSIGNMENTS, len(total))
        top = np.argpartition(-total, m - 1)[:m]
        top = top[np.argsort(-total[top], kind="stable")]
        top = top[total[top] >= total[top[0]] + 0.5 * IMPOSSIBLE]
        hypotheses, *chosen = np.unravel_index(top, (n_hypotheses, *n_parts * [n]))
        picked = np.stack([options[hypotheses, part, chosen[part]] for part in range(n_parts)], axis=1)
        return cls(hypotheses, picked, total[top])

    def parts(self, options: PartOptions, continued: MovingParts, jumped: MovingParts) -> MovingParts:
        """Return the posterior of the parts, `(m, n_parts)`."""
        rows, columns = self.hypotheses[:, None], np.arange(self.options.shape[1])
        shares, means, covariances = [], [], []
        for case, prior in enumerate((continued, jumped)):
            here = (rows, columns, case, self.options)
            after = prior.only(self.hypotheses).with_positions(options.means[here], options.covariances[here])
            shares.append(options.shares[here])
            means.append(after.means)
            covariances.append(after.covariances)
        share = np.stack(shares)[..., None]
        mean = (share * np.stack(means)).sum(axis=0)
        apart = np.stack(means) - mean
        scatter = np.stack(covariances) + apart[..., :, None] * apart[..., None, :]
        return MovingParts(mean, (share[..., None] * scatter).sum(axis=0))

    def labels(self, detections: PartDetections) -> NDArray[np.int64]:
        """`(m, n_parts)`: labels of the detections that parts are, or are hidden by; -1 for none."""
        k = len(detections.labels)
        padded = np.append(detections.labels, NO_LABEL)
        return np.asarray(padded[np.where(self.options <= k, self.options, self.options - k - 1)])


SIDE_TIME = 1.0  # s, after which the side of a hand counts as new evidence: about as long as hands stay


def log_sides(right: Array, since: Array, shoulder_width: float) -> Array:
    """`(H, 2, k)` nats: log ratio of each detection as left and right hand, by its side of the head.

    A hand is in front of its own shoulder, within about half the shoulders' distance. The same position
    seen again is not independent: it counts by the time that passed since.

    `right` `(H, k)` px: how far detections are to the right of the head; `since` `(H, 2)` s since the hands
    were seen; `shoulder_width`: px.
    """
    odds = right * 4 / shoulder_width
    own = np.log(2) - np.logaddexp(0.0, np.stack([-odds, odds], axis=1))
    return np.asarray(-np.expm1(-since[:, :, None] / SIDE_TIME) * own)


def ratios_beside(places: Array, radii: Array, number: float, densities: Array) -> Array:
    """`(n_parts, k, k)`: ratio of a second detection of a part against new clutter, given the first one.

    `places` `(k, 2)` px of detections; `radii` `(n_parts,)` px: standard deviations of further detections of
    a part about it; `number`: of these, on average; `densities` `(k,)` of new clutter there, per px^2.
    """
    squares = ((places[:, None] - places) ** 2).sum(axis=2)
    width = radii[:, None, None] ** 2
    return np.asarray(number / (2 * np.pi * width * densities) * np.exp(-0.5 * squares / width))


def log_overlaps(options: PartOptions, message: PartMessage) -> Array:
    """`(H, 3, n)` nats: log overlap of each part's options with the marginals of the chains' message."""
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
    """`(m,)` nats: log of the integral of the chains' message times Gaussians of all parts, `(m, 3)`."""
    n = len(message.log_hypotheses)
    means = np.tile(parts.means[..., :2].swapaxes(0, 1), (n, 1, 1))
    covariances = np.tile(parts.covariances[..., :2, :2].swapaxes(0, 1), (n, 1, 1, 1))
    overlaps = message.stacked.log_overlaps(means, covariances).reshape(n, 3, -1).sum(axis=1)
    return log_sums(overlaps + message.log_hypotheses[:, None], axis=0)
