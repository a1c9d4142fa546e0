"""Poses of a deformable object, many at once: rotation, translation and morph coefficients, u = {r, l, c}."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from ..numerics.rotations import exponential, logarithm, nearest_rotation

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

    def replaced(self, which: NDArray[np.int64], poses: "Poses") -> Self:
        """With `poses` in the places `which` `(k,)`."""
        parts = []
        for name in ("rotations", "translations", "morphs"):
            part = getattr(self, name).copy()
            part[which] = getattr(poses, name)
            parts.append(part)
        return type(self)(*parts)

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
