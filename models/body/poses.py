"""Poses of an upper body, many at once: where it is, how torso and neck turn, where its arms point."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from ..numerics.rotations import logarithm
from ..numerics.threads import over_bands

Array = NDArray[np.float64]

ANGLES = 16
"""Degrees of freedom: two of the root, three of torso and neck each, three of a shoulder, one of an elbow."""

WORTH_THREADS = 300
"""Poses from which several threads are faster than one."""


@short_repr
@dataclass(frozen=True, eq=False)
class BodyPoses:
    """Poses of an upper body with 16 degrees of freedom, one an entry (RSMCM paper §4.1 has 13).

    x is to the right, y down and z away from the viewer; "left" is the person's own. The elbow is a hinge,
    so the directions of upper arm and forearm hold all four angles of an arm, without jumps. Everything is
    said in the picture's axes and not in those of the torso: who leans keeps the head up, and hands where
    they are.

    Parameters
    ----------
    roots
        `(n, 2)` px: the point between the shoulders.
    torsos
        `(n, 3)` rad: rotation vectors of the torso about the root; x leans it forwards, y turns its left
        shoulder to the viewer, z leans it to its left. 0 is upright and faces the camera.
    necks
        `(n, 3)` rad: rotation vectors of the head about the root.
    arms
        `(n, 2, 2, 3)`: unit vectors along the upper arm and the forearm, [left, right][upper arm, forearm].
    """

    roots: Array
    torsos: Array
    necks: Array
    arms: Array

    def __len__(self) -> int:
        return len(self.roots)

    @classmethod
    def concatenated(cls, parts: Sequence["BodyPoses"]) -> Self:
        """All poses of `parts`, one after the other."""
        return cls(
            np.concatenate([part.roots for part in parts]),
            np.concatenate([part.torsos for part in parts]),
            np.concatenate([part.necks for part in parts]),
            np.concatenate([part.arms for part in parts]),
        )

    def take(self, chosen: Any) -> Self:
        """The poses chosen by a slice, a mask or indices."""
        if isinstance(chosen, slice):
            return type(self)(self.roots[chosen], self.torsos[chosen], self.necks[chosen], self.arms[chosen])
        rows = np.asarray(chosen)
        if rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        # several times faster than `[rows]`
        return type(self)(
            self.roots.take(rows, 0),
            self.torsos.take(rows, 0),
            self.necks.take(rows, 0),
            self.arms.take(rows, 0),
        )

    def replaced(self, where: NDArray[np.bool_], others: "BodyPoses") -> Self:
        """The same, but for poses `where` `(n,)`, which are those of `others`."""
        return type(self)(
            *(
                np.where(where.reshape(-1, *[1] * (own.ndim - 1)), new, own)
                for own, new in (
                    (self.roots, others.roots),
                    (self.torsos, others.torsos),
                    (self.necks, others.necks),
                    (self.arms, others.arms),
                )
            )
        )

    def with_rows(self, rows: NDArray[np.intp], others: "BodyPoses") -> Self:
        """The same, but for poses `rows` `(k,)`, which are `others`, k of them."""
        changed = type(self)(self.roots.copy(), self.torsos.copy(), self.necks.copy(), self.arms.copy())
        changed.roots[rows], changed.torsos[rows] = others.roots, others.torsos
        changed.necks[rows], changed.arms[rows] = others.necks, others.arms
        return changed

    @property
    def turns(self) -> Array:
        """`(n, 6)` rad: rotation vectors of torso and neck."""
        return np.concatenate([self.torsos, self.necks], axis=1)

    @property
    def angles(self) -> Array:
        """`(n, 16)`: root, torso, neck, of each arm rotation vector of the shoulder and flexion of the elbow.

        A shoulder at zero lets the arm hang, and the elbow bends the forearm towards the viewer. The twist of
        a straight arm cannot be seen from its directions: it is taken from `transport`.
        """
        rotations, flexions = shoulder_rotations(self.arms)
        n = len(self)
        angles = np.empty((n, ANGLES))
        angles[:, :2], angles[:, 2:8] = self.roots, self.turns
        per_arm = angles[:, 8:].reshape(n, 2, 4)
        per_arm[:, :, :3] = logarithm(rotations.reshape(2 * n, 3, 3)).reshape(n, 2, 3)
        per_arm[:, :, 3] = flexions
        return angles


def over_bands_of(poses: BodyPoses, work: Callable[[int, int], None]) -> None:
    """Call `work(first, end)` on runs of the poses, on several threads if there are many."""
    if len(poses) < WORTH_THREADS:
        work(0, len(poses))
    else:
        over_bands(work, len(poses))


def shoulder_rotations(arms: Array) -> tuple[Array, Array]:
    """Rotations of the shoulders and flexions of the elbows of `arms` `(..., 2, 3)` [upper arm, forearm].

    Returns
    -------
    rotations
        `(..., 3, 3)`: their second column is the upper arm, their first the elbow's axis.
    flexions
        `(...)` rad, from 0 (straight) to pi.
    """
    upper, forearm = arms[..., 0, :], arms[..., 1, :]
    axis = cross(forearm, upper)
    sine = np.sqrt((axis**2).sum(-1))
    flexions = np.arctan2(sine, (upper * forearm).sum(-1))
    straight = sine < 1e-12
    axis = axis / np.where(straight, 1.0, sine)[..., None]
    if straight.any():
        axis[straight] = transport(upper[straight])[..., 0]
    return np.stack([axis, upper, cross(axis, upper)], axis=-1), flexions


def transport(upper: Array) -> Array:
    """`(..., 3, 3)`: the shortest rotations that lead a hanging arm (0, 1, 0) to `upper` `(..., 3)`."""
    x, y, z = upper[..., 0], upper[..., 1], upper[..., 2]
    square = x * x + z * z
    turned_over = (square < 1e-28) & (y < 0)
    # 1 / (1 + y), which loses its digits near the top, where it equals (1 - y) / (1 - y^2)
    below = (1 - y) / np.maximum(square, 1e-28)
    shrink = np.where(y < 0, below, 1 / np.maximum(1 + y, 0.5))
    rotations = np.empty((*upper.shape, 3))
    rotations[..., 0, 0], rotations[..., 1, 0], rotations[..., 2, 0] = 1 - x * x * shrink, -x, -x * z * shrink
    rotations[..., :, 1] = upper
    rotations[..., 0, 2], rotations[..., 1, 2], rotations[..., 2, 2] = -x * z * shrink, -z, 1 - z * z * shrink
    rotations[turned_over] = np.diag([1.0, -1.0, -1.0])
    return rotations


def cross(first: Array, second: Array) -> Array:
    """Cross products of `(..., 3)`; numpy's own is several times slower."""
    product = np.empty(np.broadcast_shapes(first.shape, second.shape))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        product[..., k] = first[..., i] * second[..., j] - first[..., j] * second[..., i]
    return product
