"""A tracker with a linear subspace of templates, in the role of the 2D+3D active appearance model (AAM).

Appearance is any linear combination of a few texture maps (G-flow paper, Table 3 and §7.2.4), learned once
from pictures in which the pose is known and fixed from then on. In every frame one pose is estimated by
Gauss-Newton, for which the coefficients of appearance are eliminated ("projected out").

Departures from the AAM: shape is the 3-D model alone, without a 2-D one beside it; texels that are hidden are
left out, both where it learns and where it tracks; slopes are those of the picture and not, inverse
compositional, of the template.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ....chains.face.gauss_newton import Modes, find_modes
from ....chains.face.image_pyramid import MIDDLE_GREY, Level
from ....chains.face.pose_dynamics import PosePrior
from ....chains.face.texture_likelihood import Equations, TexturedObject, TextureLikelihood
from ....models.face.pose import Poses

Array = NDArray[np.float64]
Map = NDArray[np.float32]
Mask = NDArray[np.bool_]

EM_STEPS = 30
LEAST_NOISE = 36.0
"""Squared grey levels: of a texel about the subspace, at least."""


@dataclass(frozen=True, eq=False)
class TextureSubspace:
    """Textures as a mean and linear combinations of modes, with coefficients that are standard normal.

    Parameters
    ----------
    mean
        `(n_levels, n_texels)` float32 grey levels, on each level of the picture.
    modes
        `(n_modes, n_levels, n_texels)` float32 grey levels; orthogonal on the finest level, largest first.
    noise
        squared grey levels: of a texel about the subspace.
    known
        `(n_texels,)` bool: texels that were ever seen.
    """

    mean: Map
    modes: Map
    noise: float
    known: Mask

    @classmethod
    def learned(cls, observed: Map, seen: Mask, n_modes: int) -> Self:
        """Principal components of aligned textures of which texels may be missing: EM for probabilistic PCA.

        Parameters
        ----------
        observed
            `(n_pictures, n_levels, n_texels)` grey levels: the surface as pictures of known pose show it.
        seen
            `(n_pictures, n_texels)` bool: the other texels are missing.
        n_modes
            how many, fewer than pictures.

        Raises
        ------
        ValueError
            if there are not more pictures than modes, or shapes do not fit.
        """
        if observed.ndim != 3 or seen.shape != (len(observed), observed.shape[2]):
            raise ValueError(
                f"observed: got {observed.shape} with {seen.shape} seen, expected (n_pictures, n_levels, "
                "n_texels) with (n_pictures, n_texels)"
            )
        n = len(observed)
        if not 0 <= n_modes < n:
            raise ValueError(f"modes: got {n_modes} for {n} pictures, expected 0 to {n - 1}")
        known, finest = np.any(seen, axis=0), observed[:, 0].astype(np.float64)
        weight = seen.astype(np.float64)
        mean = (weight * finest).sum(axis=0) / np.maximum(weight.sum(axis=0), 1)
        off = weight * (finest - mean)
        left, values, right = np.linalg.svd(off, full_matrices=False)
        modes = values[:n_modes, None] / np.sqrt(n) * right[:n_modes]
        rest = off - (left[:, :n_modes] * values[:n_modes]) @ right[:n_modes]
        noise = max(float((weight * rest**2).sum() / weight.sum()), LEAST_NOISE)
        for _ in range(EM_STEPS):
            first, second = _coefficients(finest, weight, mean, modes, noise)
            mean, modes = _regressed(finest, weight, first, second)
            error = (finest - mean - first @ modes) ** 2
            unsure = (second - first[:, :, None] * first[:, None]).reshape(n, -1) @ _squares(modes)
            noise = max(float((weight * (error + unsure)).sum() / weight.sum()), LEAST_NOISE)
        turn = np.linalg.svd(modes, full_matrices=False)[0]
        first, second = _coefficients(finest, weight, mean, turn.T @ modes, noise)
        levels = [
            _regressed(observed[:, level].astype(np.float64), weight, first, second)
            for level in range(observed.shape[1])
        ]
        return cls(
            np.where(known, np.stack([mean for mean, _ in levels]), MIDDLE_GREY).astype(np.float32),
            np.stack([modes for _, modes in levels], axis=1).astype(np.float32) * known,
            noise,
            known,
        )


def _squares(modes: Array) -> Array:
    """`(n_modes^2, n_texels)`: products of all pairs of modes, texel by texel."""
    pairs: Array = (modes[:, None] * modes[None]).reshape(-1, modes.shape[1])
    return pairs


def _coefficients(
    observed: Array, weight: Array, mean: Array, modes: Array, noise: float
) -> tuple[Array, Array]:
    """First and second moments of the pictures' coefficients, `(n, n_modes)` and `(n, n_modes, n_modes)`."""
    n, n_modes = len(observed), len(modes)
    precision = (weight @ _squares(modes).T).reshape(n, n_modes, n_modes) / noise + np.eye(n_modes)
    covariance = np.linalg.inv(precision)
    first = np.einsum("fkl,fl->fk", covariance, (weight * (observed - mean)) @ modes.T / noise)
    return first, covariance + first[:, :, None] * first[:, None]


def _regressed(observed: Array, weight: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Mean `(n_texels,)` and modes `(n_modes, n_texels)` that explain the observed best, texel by texel."""
    n, n_modes = first.shape
    moments = np.ones((n, n_modes + 1, n_modes + 1))
    moments[:, 1:, 1:], moments[:, 0, 1:], moments[:, 1:, 0] = second, first, first
    gram = (weight.T @ moments.reshape(n, -1)).reshape(-1, n_modes + 1, n_modes + 1)
    gram += 1e-6 * np.eye(n_modes + 1)  # texels that were never seen
    right = (weight * observed).T @ moments[:, 0]
    solved = np.linalg.solve(gram, right[..., None])[..., 0].astype(np.float64, copy=False)
    return solved[:, 0], solved[:, 1:].T


@dataclass(frozen=True, eq=False)
class SubspaceLikelihood:
    """A frame seen with a subspace of templates, of which the best is meant for every pose.

    Parameters
    ----------
    surface
        shape and texels.
    levels
        of the picture, fine to coarse.
    subspace
        of textures of these texels.
    visible
        `(n_texels,)` bool, held while poses change.
    """

    surface: TexturedObject
    levels: Sequence[Level]
    subspace: TextureSubspace
    visible: Mask

    @cached_property
    def _templates(self) -> TextureLikelihood:
        """The mean, and the mean with each mode added, as if they were textures of experts."""
        subspace = self.subspace
        n, used = len(subspace.modes) + 1, self.visible & subspace.known
        mean = np.repeat(subspace.mean[None], n, axis=0)
        mean[1:] += subspace.modes
        temperature = np.full((n, len(used)), subspace.noise, np.float32)
        return TextureLikelihood(self.surface, self.levels, mean, temperature, np.tile(used, (n, 1)))

    def equations(self, level: int, poses: Poses, owner: NDArray[np.int64]) -> Equations:
        """Normal equations with appearance eliminated; `owner` does not matter, there is one subspace.

        With W = diag(a / tau), e = y - v and modes P: the coefficients' optimum is q = (P W P' + 1)^-1 P W e,
        which leaves the energy e'We - (P W e)' q, gradient J'W (e - P'q) and curvature J'WJ - J'WP' (P W P' +
        1)^-1 P W J. The kernel gives J'W (e - p_k) for each mode, so J'W p_k is a difference of two vectors.
        """
        n, n_modes = len(poses), len(self.subspace.modes)
        templates, everyone = self._templates, np.repeat(np.arange(n), n_modes + 1)
        all_of_them = templates.equations(level, poses[everyone], np.tile(np.arange(n_modes + 1), n))
        first = slice(None, None, n_modes + 1)
        vectors = all_of_them.vectors.reshape(n, n_modes + 1, -1)
        along = vectors[:, :1] - vectors[:, 1:]
        observed, area = self._sampled(level, poses)
        weight = area / self.subspace.noise
        modes = self.subspace.modes[:, level].astype(np.float64)
        right = (weight * (observed - self.subspace.mean[level])) @ modes.T
        gram = (weight @ _squares(modes).T).reshape(n, n_modes, n_modes) + np.eye(n_modes)
        solved = np.linalg.solve(gram, np.concatenate([right[..., None], along], axis=2))
        sums = all_of_them.sums[first].copy()
        sums[:, 0] -= (right * solved[..., 0]).sum(axis=1)
        return Equations(
            all_of_them.matrices[first] - np.swapaxes(along, 1, 2) @ solved[..., 1:],
            vectors[:, 0] - np.einsum("nkd,nk->nd", along, solved[..., 0]),
            sums,
            all_of_them.rows[first].copy(),
        )

    def _sampled(self, level: int, poses: Poses) -> tuple[Array, Array]:
        """Texels in the picture `(n, n_texels)`, and the areas that they stand for, 0 if not used there."""
        texels = self.surface.texels
        visible = self._templates.visible[:1].repeat(len(poses), axis=0)
        values, areas = self.surface.sampled(self.levels[level], poses, visible)
        group, used = texels.group_of_texel, texels.used_on(level)
        kept = np.bincount(group, used, minlength=len(texels.counts))  # those used stand for all of a group
        share = np.where(used, (texels.counts / kept)[group], 0.0)
        return values.astype(np.float64), np.maximum(areas, 0).astype(np.float64) * share


def best_pose(
    surface: TexturedObject,
    subspace: TextureSubspace,
    levels: Sequence[Level],
    prior: PosePrior,
    effective_pixels: float,
) -> Modes:
    """The pose in which a picture is nearest to the subspace, sought from the one before."""
    likelihood = SubspaceLikelihood(surface, levels, subspace, surface.visible(prior.mean)[0])
    return find_modes(likelihood, prior, prior.mean, effective_pixels, len(levels) - 1)
