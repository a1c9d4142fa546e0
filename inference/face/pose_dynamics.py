"""How a deformable object moves from frame to frame, and which shapes it takes: p(u_t | u_t-1)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.face.pose import RIGID, Poses

Array = NDArray[np.float64]


@short_repr
@dataclass(frozen=True)
class PoseDynamics:
    """A random walk with a weak prior of size and shape (G-flow paper §2.3).

    Lengths are in sizes of the object, its first morph coefficient; standard deviations.

    Parameters
    ----------
    rotation
        rad after one second.
    translation
        sizes after one second.
    size
        of the size, after one second.
    morphs
        of the other coefficients in sizes, after one second.
    size_range
        of the size about the one at the start.
    morph_range
        of the other coefficients about zero, in sizes.
    """

    rotation: float = 0.6
    translation: float = 1.0
    size: float = 0.05
    morphs: float = 4.0
    size_range: float = 0.15
    morph_range: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name}: got {value}, expected more than 0")

    def walk(self, size: float, dimension: int, elapsed: float) -> Array:
        """`(dimension,)` variances of a change of pose in `elapsed` seconds, for an object of `size` px."""
        deviations = np.full(dimension, self.morphs * size)
        deviations[:3] = self.rotation
        deviations[3:RIGID] = self.translation * size
        deviations[RIGID] = self.size * size
        return deviations**2 * max(elapsed, 1e-6)


@dataclass(frozen=True, eq=False)
class PosePrior:
    """p(u_t | u_t-1) of experts, each with its own previous pose.

    Parameters
    ----------
    previous
        the experts' poses.
    walk
        `(dimension,)` variances of the change since then.
    middle, spread
        `(n_bases,)` px and px squared: of the morph coefficients, whatever they were.
    """

    previous: Poses
    walk: Array
    middle: Array
    spread: Array

    @classmethod
    def after(cls, previous: Poses, dynamics: PoseDynamics, size: float, elapsed: float) -> "PosePrior":
        """Prior of poses `elapsed` seconds after `previous`, of an object that had `size` px at the start."""
        dimension = previous.dimension
        middle = np.zeros(dimension - RIGID)
        middle[0] = size
        spread = np.full(dimension - RIGID, (dynamics.morph_range * size) ** 2)
        spread[0] = (dynamics.size_range * size) ** 2
        return cls(previous, dynamics.walk(size, dimension, elapsed), middle, spread)

    def energy(self, poses: Poses, owner: NDArray[np.int64]) -> tuple[Array, Array]:
        """Minus log density `(n,)` up to a constant, and its gradient `(n, dimension)` in a change of pose.

        The gradient takes the tangent spaces of both poses for one, which they are for small turns.
        """
        change = poses.changes_from(self.previous[owner])
        off = poses.morphs - self.middle
        gradient = change / self.walk
        gradient[:, RIGID:] += off / self.spread
        energy = 0.5 * ((change**2 / self.walk).sum(axis=1) + (off**2 / self.spread).sum(axis=1))
        return energy, gradient

    @property
    def precision(self) -> Array:
        """`(dimension,)`: second derivatives of the energy."""
        precision = 1 / self.walk
        precision[RIGID:] += 1 / self.spread
        return precision

    def log_density(self, poses: Poses, owner: NDArray[np.int64]) -> Array:
        """log p(u | u_t-1) `(n,)`: density of the walk, times the factor of the range as in the paper."""
        normaliser = -0.5 * np.log(2 * np.pi * self.walk).sum()
        density: Array = normaliser - self.energy(poses, owner)[0]
        return density
