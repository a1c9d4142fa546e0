"""An affine camera in motion, as a filter: RSMCM eq. (19) with time in seconds.

A row of the camera has four numbers m (three that multiply the shape, in px per unit of it, and a translation
in px), which change with velocity m' and acceleration m''. The rows of u and of v have the same dynamics and
are seen through the same points, so they share one covariance.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...inference.kalman import kinematic
from ...inference.sfm.factor_analysis.em import CameraPrior, estimate_cameras
from ...models.core.short_repr import short_repr

Numbers = NDArray[np.float64]

ROW = 4
ORDERS = 3
VAGUE = 1e2  # standard deviation of what is not known yet, in extents of the shape's picture (and a second)
UNSTEADY = 1e-2  # noise of a motion of which nothing is known, in extents a frame


@short_repr
@dataclass(frozen=True, eq=False)
class CameraMotion:
    """What is known of the camera at one time.

    Parameters
    ----------
    mean, covariance
        `(2, 12)`: of the rows of u and v, m, m' (1/s) and m'' (1/s^2), four numbers each; `(12, 12)` of
        either.
    noise
        `(3, 2)`: by how much the variances of m, m' and m'' grow in a second of themselves; of the numbers
        that multiply the shape, and of the translation.
    """

    mean: Numbers
    covariance: Numbers
    noise: Numbers

    @property
    def camera(self) -> Numbers:
        """`(2, 4)`: position in px = camera[:, :3] @ shape + camera[:, 3]."""
        return self.mean[:, :ROW]

    @property
    def camera_covariance(self) -> Numbers:
        """`(4, 4)`, of either row."""
        return self.covariance[:ROW, :ROW]

    @classmethod
    def vague(cls, extent: float, noise: Numbers) -> Self:
        """A camera of which nothing is known, before a shape that appears about `extent` px large."""
        return cls(np.zeros((2, ORDERS * ROW)), (VAGUE * extent) ** 2 * np.eye(ORDERS * ROW), noise)

    def predict(self, dt: float) -> Self:
        """The camera `dt` seconds on; a negative `dt` is a `ValueError`.

        Eq. (19), with noise that acts all the time: two steps do the same as one of their length.
        """
        steps = kinematic(ORDERS, dt).along(ROW).transition
        covariance = steps @ self.covariance @ steps.T
        added = np.zeros((ORDERS, ORDERS, ROW))
        for order in range(1, ORDERS + 1):  # noise of a derivative moves those below it
            density = self.noise[order - 1, [0, 0, 0, 1]]
            added[:order, :order] += kinematic(order, dt).noise[:, :, None] * density
        for number in range(ROW):
            covariance[number::ROW, number::ROW] += added[:, :, number]
        return replace(self, mean=self.mean @ steps.T, covariance=0.5 * (covariance + covariance.T))

    def shaken(self, variance: float) -> Self:
        """The camera after a jerk that adds `variance` (px^2) to each number of its rows."""
        covariance = self.covariance.copy()
        covariance[range(ROW), range(ROW)] += variance
        return replace(self, covariance=covariance)

    def update(self, information: Numbers, vector: Numbers) -> Self:
        """The camera updated with a frame: information `(4, 4)` of either row, vector `(2, 4)` of u and v."""
        seen = self.covariance[:, :ROW]
        shrink = np.linalg.inv(np.eye(ROW) + information @ seen[:ROW])
        mean = self.mean + (vector - self.camera @ information) @ shrink.T @ seen.T
        covariance = self.covariance - seen @ (shrink @ information) @ seen.T
        # the block that is seen as a product: a difference of large numbers would lose sharp information
        covariance[:ROW] = (seen @ shrink).T
        covariance[:, :ROW] = covariance[:ROW].T
        return replace(self, mean=mean, covariance=0.5 * (covariance + covariance.T))


def learned_noise(
    noise: Numbers | None,
    information: Numbers,
    vector: Numbers,
    times: Numbers,
    extent: float,
    rounds: int = 1,
) -> Numbers:
    """The motion's noise, `(3, 2)` as in `CameraMotion`, that explains a stretch of frames better.

    Parameters
    ----------
    noise
        to begin with; `None` where nothing is known of it.
    information, vector
        `(n, 4, 4)` and `(n, 2, 4)` of frames, as `update` takes them.
    times
        `(n,)` s, increasing, two or more; brought onto a grid of their median distance.
    extent
        px, about how large the shape appears.
    rounds
        of the smoother; none makes the likelihood of the stretch less.
    """
    step = float(np.median(np.diff(times)))
    back = np.round((times[-1] - times) / step).astype(np.int64)
    recent = back < 2 * len(times)  # a long gap ends the stretch
    place = back[recent][0] - back[recent]
    n_steps = int(place[-1]) + 1
    of_grid, vector_of_grid = np.zeros((n_steps, ROW, ROW)), np.zeros((n_steps, ROW, 2))
    np.add.at(of_grid, place, extent**2 * information[recent])
    np.add.at(vector_of_grid, place, extent * vector[recent].transpose(0, 2, 1))
    per_step = step ** (2 * np.arange(ORDERS)[:, None] + 1) / extent**2
    first = np.full((ORDERS, 2), UNSTEADY**2) if noise is None else noise * per_step
    prior = CameraPrior(first, coherent=True)
    for _ in range(rounds):
        prior = estimate_cameras(of_grid, vector_of_grid, 1.0, prior).better
    return prior.variance / per_step
