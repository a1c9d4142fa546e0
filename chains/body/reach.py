"""Where head and hands may be of which nothing is known."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import UpperBody
from .flesh_state import HANDS, HEAD, FleshTracks
from .moving_parts import MovingParts

Array = NDArray[np.float64]

HANDS_BELOW = 0.25
"""Of an arm's length: how far below the shoulder the middle of the places is where a hand may be."""


def anywhere(
    body: UpperBody, size: tuple[int, int], speeds: Array, heads: MovingParts, trust: Array
) -> MovingParts:
    """A head in the picture, hands in reach of their shoulders: `(H, 3)`.

    Positions have the moments of a uniform distribution over the picture, and over a disc.

    Parameters
    ----------
    size
        `(height, width)` px of the picture.
    speeds
        `(3,)` px/s, standard deviations of velocities.
    heads, trust
        `(H,)` heads, and the probabilities that they are there.
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
