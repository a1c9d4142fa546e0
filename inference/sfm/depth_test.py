"""Whether motion shows a shape in depth, or a flat one would do."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .factor_analysis.em import LEAST_NOISE
from .factor_analysis.factorisation import Factorisation
from .factor_analysis.initialisation import RANK, freedom
from .factor_analysis.observations import Observations, determined
from .factor_analysis.variable_projection import NEAR, variable_projection

PRECISION = 1e-4
MOST_STEPS = 60


@dataclass(frozen=True)
class Depth:
    """How much better than a flat shape one in depth explains the observations.

    Parameters
    ----------
    gain
        squared error that the third direction takes away, in variances of the noise.
    needed
        what it has to take away: log(numbers observed) for each number that it needs.
    """

    gain: float
    needed: float

    @property
    def determined(self) -> bool:
        """Whether there is depth in what was seen."""
        return self.gain > self.needed


def depth(positions: ArrayLike, weights: ArrayLike | None, found: Factorisation) -> Depth:
    """Compare the best shape in depth with the best flat one, by Schwarz's criterion (BIC).

    Before a static camera, under a motion in the picture plane, or of a flat scene, positions (less their
    mean) have rank 2, and a third direction fits noise. It has 2 n_frames + n_points - 6 numbers; fitting
    noise, they take away at most about twice as many variances (the largest singular value of a random
    matrix), so that a criterion of log(numbers observed) for each leaves room, whatever the scene. Errors
    of a tracker that last may still pass for depth.

    Parameters
    ----------
    positions, weights
        as `factorise` took them.
    found
        what it gave.

    Raises
    ------
    ValueError
        as `factorise` does.
    """
    observations = Observations.from_arrays(positions, weights)
    frames, points = determined(observations, apart=found.coherent)
    part = observations.only(frames, points)
    needed = float(2 * frames.sum() + points.sum() - 2 * RANK) * float(np.log(2 * part.count))
    left = freedom(part)
    if left <= 0:  # everything is fitted, and nothing is left to tell noise by
        return Depth(0.0, needed)
    cameras = observations.scaled(found.cameras)
    deep = variable_projection(part, cameras, damping=NEAR, tolerance=PRECISION, most_steps=MOST_STEPS)
    noise = max(deep.error / left, LEAST_NOISE**2)
    cameras[..., 2] = 0  # the axis that moves points least
    flat = variable_projection(
        part,
        cameras,
        rank=2,
        damping=NEAR,
        tolerance=PRECISION,
        most_steps=MOST_STEPS,
        enough=deep.error + needed * noise,
    )
    return Depth((flat.error - deep.error) / noise, needed)
