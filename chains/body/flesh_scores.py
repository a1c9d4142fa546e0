"""What else speaks for a thing in the picture being some part: sides, other things about it, other chains."""

import numpy as np
from numpy.typing import NDArray

from ...models.body.part_message import PartMessage
from ...models.numerics.densities import log_sums
from .flesh_assignment import PartOptions
from .moving_parts import MovingParts

Array = NDArray[np.float64]

LOOKS_APART = 1.0
"""s, after which it is a new look that hands are on their own sides."""


def log_sides(right: Array, since: Array, shoulder_width: float) -> Array:
    """`(H, 2, k)` nats: things as left and right hand, by the side on which they are.

    A hand is before its own shoulder, give or take half of their distance. As a hand stays where it is, the
    same look again counts only as far as it was forgotten.

    Parameters
    ----------
    right
        `(H, k)` px: how far things are to the right of the head.
    since
        `(H, 2)` s since the hands were seen.
    shoulder_width
        px.
    """
    odds = right * 4 / shoulder_width
    own = np.log(2) - np.logaddexp(0.0, np.stack([-odds, odds], axis=1))
    return np.asarray(-np.expm1(-since[:, :, None] / LOOKS_APART) * own)


def ratios_beside(places: Array, radii: Array, number: float, densities: Array) -> Array:
    """`(n_parts, k, k)`: of a part that is one thing, how much more probable another is as more of that part.

    Parameters
    ----------
    places
        `(k, 2)` px of things.
    radii
        `(n_parts,)` px: standard deviations of other things of a part about it.
    number
        of these, on average.
    densities
        `(k,)` of something new there, per px^2.
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
