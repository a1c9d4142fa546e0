"""How a deformable object moves, and which shapes it takes: p(u_t | u_s) for any time t after s."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.face.pose import RIGID, Poses

Array = NDArray[np.float64]

SHORTEST = 1e-6
"""s: two pictures of one time are taken for this far apart, so that no variance is 0."""


@short_repr
@dataclass(frozen=True)
class PoseDynamics:
    """A random walk in continuous time, of which size and shape are drawn back to what is usual.

    Rotation and translation: du = Q^1/2 dw. A morph coefficient c of usual value m, range s and walk q is an
    Ornstein-Uhlenbeck process, dc = q (m - c) / (2 s^2) dt + q^1/2 dw, whose distribution in the long run is
    N(m, s^2). Departure: the paper (§2.3) multiplies the walk by N(m, s^2) once a frame, which draws the more
    the more frames a second has.

    Lengths are in sizes of the object, its first morph coefficient; standard deviations.

    Parameters
    ----------
    rotation
        rad after one second.
    translation
        sizes after one second.
    size
        of the size, after one second of a free walk.
    morphs
        of the other coefficients in sizes, after one second of a free walk.
    size_range
        of the size about the one at the start.
    morph_range
        of the other coefficients about zero, in sizes.
    """

    rotation: float = 0.6
    translation: float = 1.0
    size: float = 0.05
    morphs: float = 4.0
    size_range: float = 0.11
    morph_range: float = 0.8

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name}: got {value}, expected more than 0")

    def transition(self, size: float, dimension: int, elapsed: float) -> tuple[Array, Array]:
        """Moments of poses after `elapsed` seconds, for an object that had `size` px at the start.

        Returns
        -------
        memory
            `(dimension - 5,)`: share of the deviations from the usual morph coefficients that is left.
        variance
            `(dimension,)` of the change about that.
        """
        rates = np.full(dimension, (self.morphs * size) ** 2)
        rates[:3] = self.rotation**2
        rates[3:RIGID] = (self.translation * size) ** 2
        rates[RIGID] = (self.size * size) ** 2
        walk = rates * max(elapsed, SHORTEST)
        spread = np.full(dimension - RIGID, (self.morph_range * size) ** 2)
        spread[0] = (self.size_range * size) ** 2
        forgotten = walk[RIGID:] / spread
        walk[RIGID:] = -spread * np.expm1(-forgotten)
        return np.exp(-0.5 * forgotten), walk


@dataclass(frozen=True, eq=False)
class PosePrior:
    """p(u_t | u_s) of experts, each with its own earlier pose: Gaussian in a change from the expected pose.

    Parameters
    ----------
    mean
        the expected poses.
    variance
        `(dimension,)` of a change from them.
    """

    mean: Poses
    variance: Array

    @classmethod
    def after(cls, previous: Poses, dynamics: PoseDynamics, size: float, elapsed: float) -> "PosePrior":
        """Prior of poses `elapsed` seconds after `previous`, of an object that had `size` px at the start."""
        memory, variance = dynamics.transition(size, previous.dimension, elapsed)
        usual = np.zeros(len(memory))
        usual[0] = size
        return cls(replace(previous, morphs=usual + memory * (previous.morphs - usual)), variance)

    def energy(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array]:
        """Minus log density `(n,)` up to a constant, and its gradient `(n, dimension)` in a change of pose.

        The gradient takes the tangent spaces of both poses for one, which they are for small turns.
        """
        change = poses.changes_from(self.mean[owner])
        gradient = change * self.precision
        return 0.5 * (change * gradient).sum(axis=1), gradient

    @property
    def precision(self) -> Array:
        """`(dimension,)`: second derivatives of the energy."""
        return 1 / self.variance

    def log_density(self, poses: Poses, owner: NDArray[np.int64]) -> Array:
        """log p(u_t | u_s) `(n,)`."""
        normaliser = -0.5 * np.log(2 * np.pi * self.variance).sum()
        density: Array = normaliser - self.energy(poses, owner)[0]
        return density
