"""Poses of a deformable object, many at once: rotation, translation and morph coefficients, u = {r, l, c}."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr

Array = NDArray[np.float64]

RIGID = 5
"""Degrees of freedom of rotation and translation, which come before the morph coefficients."""


@short_repr
@dataclass(frozen=True, eq=False)
class Poses:
    """Poses under weak perspective, one an entry (G-flow paper §2.1).

    Small changes of a pose are vectors of `dimension` numbers: a rotation vector w (rad) that turns the
    object as the camera sees it, r <- exp([w]x) r, then px of translation, then changes of the coefficients.

    Parameters
    ----------
    rotations
        `(n, 3, 3)`, from the object to the camera: x right, y down, z away from the viewer.
    translations
        `(n, 2)` px: where the object's origin is seen.
    morphs
        `(n, n_bases)` px: weights of the morph bases; the first is the size of the object in the picture.
    """

    rotations: Array
    translations: Array
    morphs: Array

    def __len__(self) -> int:
        return len(self.rotations)

    def __getitem__(self, chosen: Any) -> Self:
        """The poses chosen by a slice, a mask or indices; a single number gives a batch of one."""
        if isinstance(chosen, int | np.integer):
            chosen = [chosen]
        return type(self)(self.rotations[chosen], self.translations[chosen], self.morphs[chosen])

    @property
    def dimension(self) -> int:
        """Degrees of freedom: five and one for each morph basis."""
        return RIGID + int(self.morphs.shape[1])

    @property
    def sizes(self) -> Array:
        """`(n,)` px: the first morph coefficient, c_1."""
        return self.morphs[:, 0]

    @classmethod
    def upright(cls, translations: Array, sizes: Array, n_bases: int) -> Self:
        """Unturned and undeformed objects at `translations` `(n, 2)` px, of `sizes` `(n,)` px."""
        n = len(translations)
        morphs = np.zeros((n, n_bases))
        morphs[:, 0] = sizes
        return cls(np.tile(np.eye(3), (n, 1, 1)), np.asarray(translations, np.float64), morphs)

    @classmethod
    def concatenated(cls, parts: Sequence["Poses"]) -> Self:
        """All poses of `parts`, one after the other."""
        return cls(
            np.concatenate([part.rotations for part in parts]),
            np.concatenate([part.translations for part in parts]),
            np.concatenate([part.morphs for part in parts]),
        )

    def moved(self, changes: Array) -> Self:
        """The poses changed by `changes` `(n, dimension)`; one pose may be moved in many ways."""
        turned = exponential(changes[:, :3]) @ self.rotations
        # one Newton step towards the nearest rotation keeps rounding from growing over a long film
        turned = turned @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(turned, -1, -2) @ turned)
        return type(self)(turned, self.translations + changes[:, 3:5], self.morphs + changes[:, 5:])

    def changes_from(self, other: "Poses") -> Array:
        """`(n, dimension)`: the changes that lead from `other` to these poses, `other.moved(...)`."""
        turned = logarithm(self.rotations @ np.swapaxes(other.rotations, -1, -2))
        return np.concatenate(
            [turned, self.translations - other.translations, self.morphs - other.morphs], axis=1
        )

    def mean(self, weights: Array) -> Self:
        """One pose: the weighted mean, for rotations the chordal one (nearest to the mean matrix)."""
        share = weights / weights.sum()
        rotation = nearest_rotation(np.einsum("n,nij->ij", share, self.rotations))
        return type(self)(rotation[None], (share @ self.translations)[None], (share @ self.morphs)[None])


def exponential(vectors: Array) -> Array:
    """`(n, 3, 3)` rotations exp([w]x) about the rotation vectors `(n, 3)` rad (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[:, None, None]
    cross = cross_matrices(vectors)
    sine = np.sinc(angle / np.pi)
    versine = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2  # (1 - cos) / angle^2 without its cancellation
    rotations: Array = np.eye(3) + sine * cross + versine * (cross @ cross)
    return rotations


def logarithm(rotations: Array) -> Array:
    """`(n, 3)` rad: rotation vectors, shorter than or equal to pi, of the rotations `(n, 3, 3)`."""
    twice_sine = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    sine = 0.5 * np.linalg.norm(twice_sine, axis=1)
    cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1)
    angle = np.arctan2(sine, cosine)
    vectors: Array = 0.5 * twice_sine / np.sinc(angle / np.pi)[:, None]
    turned_round = cosine < -0.9  # the sine fades, and the axis with it
    if turned_round.any():
        from scipy.spatial.transform import Rotation

        vectors[turned_round] = Rotation.from_matrix(rotations[turned_round]).as_rotvec()
    return vectors


def cross_matrices(vectors: Array) -> Array:
    """[w]x for which [w]x p = w x p: `(..., 3, 3)` for vectors `(..., 3)`."""
    matrices = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    matrices[..., 0, 1], matrices[..., 0, 2], matrices[..., 1, 2] = -z, y, -x
    matrices[..., 1, 0], matrices[..., 2, 0], matrices[..., 2, 1] = z, -y, x
    return matrices


def nearest_rotation(matrices: Array) -> Array:
    """The rotations nearest to `matrices` `(..., 3, 3)` in the Frobenius norm."""
    left, _, right = np.linalg.svd(matrices)
    sign = np.linalg.det(left @ right)
    left = left.copy()
    left[..., :, 2] *= sign[..., None]
    nearest: Array = left @ right
    return nearest
