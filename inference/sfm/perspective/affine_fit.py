"""Affine cameras and shape under noise with heavy tails, and how likely they make what was seen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..factor_analysis.connectivity import determined
from ..factor_analysis.factorisation import projected
from ..factor_analysis.observations import Numbers, Observations
from ..factor_analysis.variable_projection import NEAR, least_squares
from .student_noise import StudentNoise

MOST_ROUNDS = 15
SETTLED = 1e-3
"""Nats an observation: a round that gains less is the last."""
PRECISION, MOST_STEPS = 1e-3, 20
"""Of the least squares of a round: the next one has other weights."""


@dataclass(frozen=True, eq=False)
class AffineFit:
    """Cameras and shape under Student's noise.

    Parameters
    ----------
    cameras, shape
        `(n_frames, 2, 4)` and `(n_points, 3)`, in px.
    frames, points
        `(n_frames,)` and `(n_points,)` bool: which the observations determine; others are not fitted.
    weights
        `(n_frames, n_points)`: as given, less what makes an observation an outlier.
    noise
        px^2 at weight 1.
    log_likelihood
        of the observations of those frames and points, nats.
    """

    cameras: Numbers
    shape: Numbers
    frames: NDArray[np.bool_]
    points: NDArray[np.bool_]
    weights: Numbers
    noise: StudentNoise
    log_likelihood: float


def affine_fit(positions: ArrayLike, weights: ArrayLike, cameras: Numbers, shape: Numbers) -> AffineFit:
    """Make observations likelier, by weighted least squares whose weights follow from the round before.

    Parameters
    ----------
    positions, weights
        as of `factorise`.
    cameras, shape
        `(n_frames, 2, 4)` and `(n_points, 3)`, the start.

    Raises
    ------
    ValueError
        as `factorise` does, but frames may fall into sets that share no points.
    """
    where, given = np.asarray(positions, np.float64), np.asarray(weights, np.float64)
    frames, points = determined(Observations.from_arrays(where, given), apart=True)
    seen = (given > 0) & frames[:, None] & points
    best: AffineFit | None = None
    counted = given
    for _ in range(MOST_ROUNDS):
        squares = np.sum((where - projected(cameras, shape)) ** 2, axis=2)[seen]
        noise = StudentNoise.of_errors(squares, given[seen])
        likelihood = noise.log_likelihood(squares, given[seen])
        before = -np.inf if best is None else best.log_likelihood
        counted = given.copy()
        counted[seen] = noise.weights(squares, given[seen])
        if likelihood > before:
            best = AffineFit(cameras, shape, frames, points, counted, noise, likelihood)
        if likelihood < before + SETTLED * len(squares):
            break
        cameras, shape = _refitted(where, np.where(seen, counted, 0), cameras)
    assert best is not None
    return best


def _refitted(positions: Numbers, weights: Numbers, cameras: Numbers) -> tuple[Numbers, Numbers]:
    observations = Observations.from_arrays(positions, weights)
    found = least_squares(
        observations,
        observations.scaled(cameras),
        damping=NEAR,
        tolerance=PRECISION,
        most_steps=MOST_STEPS,
    )
    moved = found.cameras * observations.scale
    moved[..., 3] += observations.centre
    return moved, found.shape
