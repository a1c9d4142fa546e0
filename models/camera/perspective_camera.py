"""Perspective cameras of one focal length, in a parametrisation that includes the affine camera.

A point p = R X in front of a camera with focal length f and translation T is seen at f (p_xy + T_xy) / (p_z +
T_z) from the principal point. With a = f / T_z (the scale at the origin of the shape), u = f T_xy / T_z
(the image of the origin) and q = 1 / f that is

    x = (a p_xy + u) / (1 + q a p_z),

which for q = 0 is scaled orthography (Christy and Horaud, "Euclidean shape and motion from multiple
perspective views by affine iterations", 1996, with their epsilon = q a p_z). A mirrored shape (z is -z) with
-q is seen in the same places: of the two shapes that an affine camera cannot tell apart, one has a negative
focal length. The origin of the shape has to be in front of all cameras.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr

Array = NDArray[np.float64]

MIRROR = np.diag([1.0, 1.0, -1.0])
NEAREST = 1e-2  # least depth of a point in front of a camera, in depths of the shape's origin


@short_repr
@dataclass(frozen=True, eq=False)
class PerspectiveCameras:
    """Cameras of one focal length, square pixels, and a given principal point.

    Parameters
    ----------
    rotations, scales, shifts
        `(n_frames, 3, 3)` from the shape to the camera; `(n_frames,)` positive, px per unit of the shape at
        the depth of its origin; `(n_frames, 2)` px from the principal point, where the origin is seen.
    curvature
        1 / focal length, 1/px; 0 for a camera far away.
    principal
        `(2,)` px, the principal point.
    """

    rotations: Array
    scales: Array
    shifts: Array
    curvature: float
    principal: Array

    @property
    def focal(self) -> float:
        """Focal length, px; infinite for a camera far away."""
        return 1 / self.curvature if self.curvature else np.inf

    @property
    def translations(self) -> Array:
        """Translations T `(n_frames, 3)` in the shape's unit, for a finite focal length."""
        depth = self.focal / self.scales[:, None]
        return np.concatenate([self.shifts * self.curvature * depth, depth], axis=1)

    @property
    def affine(self) -> Array:
        """Affine cameras `(n_frames, 2, 4)` that agree at the depth of the shape's origin."""
        rows = self.scales[:, None, None] * self.rotations[:, :2]
        return np.concatenate([rows, (self.shifts + self.principal)[:, :, None]], axis=2)

    @property
    def centres(self) -> Array:
        """Camera centres `(n_frames, 3)` in the shape's axes."""
        places: Array = -np.einsum("tji,tj->ti", self.rotations, self.translations)
        return places

    def seen(self, shape: Array) -> tuple[Array, Array]:
        """Return positions `(n_frames, n_points, 2)` px of points `(n_points, 3)`, and their depths.

        Depths `(n_frames, n_points)` are in units of that of the shape's origin; below `NEAREST` a point is
        not in front of the camera, and its position is undefined.
        """
        turned = self.scales[:, None, None] * np.einsum("tjk,ik->tij", self.rotations, shape, optimize=True)
        depths = 1 + self.curvature * turned[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            places = (turned[..., :2] + self.shifts[:, None]) / depths[..., None]
        return places + self.principal, depths

    def mirrored(self) -> Self:
        """Return the cameras that see shape @ `MIRROR` where these see the shape."""
        return replace(self, rotations=MIRROR @ self.rotations @ MIRROR, curvature=-self.curvature)

    def of(self, frames: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """Return the cameras of some frames."""
        return replace(
            self, rotations=self.rotations[frames], scales=self.scales[frames], shifts=self.shifts[frames]
        )
