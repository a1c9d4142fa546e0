"""A batch tracker with one generative template, in the role of Torresani and Hertzmann's (ECCV 2004).

EM over a whole clip (G-flow paper, Table 3 and §7.1.1). Every frame shows the same template through noise, of
which each texel has its own, save where a texel is occluded or an outlier and shows anything. Hidden are, for
each frame, which texels those are and the morph coefficients, of which a Gaussian is kept; turn and place of
the object are parameters with a single value, like template, noises and the share of outliers.

Departures: morph bases are given and not learned; turn, place and the middle of the Gaussian are improved
together by the Gauss-Newton search of the other trackers; texels that the shape itself hides are left out;
pixels count for fewer than they are, since they depend on each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....chains.face.gauss_newton import find_modes
from ....chains.face.image_pyramid import MIDDLE_GREY, Level, image_pyramid
from ....chains.face.pose_dynamics import PoseDynamics, PosePrior
from ....chains.face.texture_likelihood import TexturedObject, TextureLikelihood
from ....models.face.pose import RIGID, Poses

Array = NDArray[np.float64]
Map = NDArray[np.float32]

FIRST_NOISE, LEAST_NOISE = 20.0**2, 4.0
"""Squared grey levels: of a texel about the template before and after anything is learned."""

FIRST_OUTLIERS, OUTLIER_LIMITS = 0.05, (0.01, 0.5)
"""Share of outliers, and between which shares the learned one stays."""

N_GREYS = 256.0
"""An outlier shows any grey level."""

COARSE_ROUNDS = 2
"""Rounds of EM in which poses are sought on coarse levels first."""

FREE_SECONDS = 100.0
"""Poses may be as far from the start as a walk of this length goes: nearly anywhere."""


@dataclass(frozen=True, eq=False)
class ClipTemplate:
    """What EM made of a clip.

    Parameters
    ----------
    poses
        one a frame; their morph coefficients are the means of the Gaussians.
    morph_covariance
        `(n_frames, n_bases, n_bases)` px squared.
    template
        `(n_levels, n_texels)` float32 grey levels.
    noise
        `(n_texels,)` float32, squared grey levels.
    outliers
        share of the visible surface that is occluded or otherwise no template.
    occlusion
        `(n_frames,)`: the same in every frame.
    bounds
        nats: lower bound of the clip's log evidence in each round, of its effective pixels.
    """

    poses: Poses
    morph_covariance: Array
    template: Map
    noise: Map
    outliers: float
    occlusion: Array
    bounds: Array


@dataclass(frozen=True, eq=False)
class _FrameSums:
    """Sums over frames from which the template, its noises and the share of outliers are made."""

    weight: Array
    observed: Array
    squares: Array
    unsure: Array
    inliers: float = 0.0
    total: float = 0.0

    def template(self) -> Map:
        """`(n_levels, n_texels)`: weighted mean of what frames show."""
        mean = self.observed / np.maximum(self.weight, 1e-9)
        return np.where(self.weight > 1e-9, mean, MIDDLE_GREY).astype(np.float32)

    def noise(self) -> Map:
        """`(n_texels,)`: weighted mean square about the template, with what the uncertain shape adds."""
        weight = np.maximum(self.weight, 1e-9)
        middle = self.observed[0] / weight
        spread = (self.squares + self.unsure) / weight - middle**2
        return np.where(self.weight > 1e-9, np.maximum(spread, LEAST_NOISE), FIRST_NOISE).astype(np.float32)


@dataclass(frozen=True)
class GenerativeTemplate:
    """Batch EM of one template.

    Parameters
    ----------
    surface
        shape and texels.
    effective_pixels
        number of independent pixels that the object's pixels in a frame are worth.
    levels
        of the pictures, from the finest.
    local_mean
        divide pictures by their local mean.
    rounds
        of EM.
    """

    surface: TexturedObject
    effective_pixels: float = 400.0
    levels: int = 3
    local_mean: bool = True
    rounds: int = 8

    def fit(self, pictures: Sequence[NDArray[np.uint8]], start: Poses) -> ClipTemplate:
        """Track an object through a whole clip.

        Parameters
        ----------
        pictures
            of all frames, uint8, grey or BGR.
        start
            a pose in every frame from another tracker. The first one is taken as given, and what the first
            picture shows there is the template to begin with: nothing else ties the template to the surface.

        Raises
        ------
        ValueError
            if there is not one pose a picture, or no picture.
        """
        if not len(pictures) or len(pictures) != len(start):
            raise ValueError(
                f"start: got {len(start)} poses for {len(pictures)} pictures, expected one for each"
            )
        size = float(start.sizes[0])
        n_bases = start.morphs.shape[1]
        covariance = np.zeros((len(start), n_bases, n_bases))
        clip = ClipTemplate(
            start,
            covariance,
            *self._first_template(pictures, start),
            FIRST_OUTLIERS,
            np.zeros(len(start)),
            np.zeros(0),
        )
        prior = PosePrior.after(start, PoseDynamics(), size, FREE_SECONDS)
        for number in range(self.rounds):
            clip = self._round(clip, pictures, prior, self.levels - 1 if number < COARSE_ROUNDS else 0)
        return clip

    def _levels(self, picture: NDArray[np.uint8], size: float) -> list[Level]:
        return image_pyramid(picture, size, n_levels=self.levels, local_mean=self.local_mean)

    def _first_template(self, pictures: Sequence[NDArray[np.uint8]], start: Poses) -> tuple[Map, Map]:
        """What the first picture shows; where that is nothing, the mean of what the others do."""
        n = len(self.surface.texels)
        total, count = np.zeros((self.levels, n)), np.zeros(n)
        for number, picture in enumerate(pictures):
            pose = start[number]
            levels = self._levels(picture, float(start.sizes[0]))
            observed, seen = self.surface.observe(levels, pose, self.surface.visible(pose))
            # the first picture's share is as large as no number of others', which are then passed over
            share = 1.0 if number else float(len(pictures))
            weight = seen[0] * np.where(count >= len(pictures), 0.0, share)
            total += weight * observed[0]
            count += weight
        mean = np.where(count > 0, total / np.maximum(count, 1), MIDDLE_GREY)
        return mean.astype(np.float32), np.full(n, FIRST_NOISE, np.float32)

    def _round(
        self, clip: ClipTemplate, pictures: Sequence[NDArray[np.uint8]], prior: PosePrior, coarsest: int
    ) -> ClipTemplate:
        """E step in every frame, then M step."""
        n_texels = len(self.surface.texels)
        zero = np.zeros(n_texels)
        sums = _FrameSums(zero, np.zeros((self.levels, n_texels)), zero, zero)
        poses, covariances, occlusion, bound = [], [], [], 0.0
        for number, picture in enumerate(pictures):
            levels = self._levels(picture, float(prior.mean.sizes[0]))
            own = replace(prior, mean=prior.mean[number])
            frame = _Frame(self, clip, levels, own, self.surface.visible(clip.poses[number])[0])
            pose = clip.poses[number]
            if number:
                pose = frame.sought(pose, clip.morph_covariance[number], coarsest)
            covariance = frame.covariance(pose, clip.morph_covariance[number])
            sums, inside, its_bound = frame.judged(pose, covariance, sums)
            poses.append(pose)
            covariances.append(covariance)
            occlusion.append(1 - inside)
            bound += its_bound
        return ClipTemplate(
            Poses.concatenated(poses),
            np.stack(covariances),
            sums.template(),
            sums.noise(),
            float(np.clip(1 - sums.inliers / max(sums.total, 1e-9), *OUTLIER_LIMITS)),
            np.array(occlusion),
            np.append(clip.bounds, bound),
        )


@dataclass(frozen=True, eq=False)
class _Frame:
    """One frame in the E step, under the template of the round before."""

    tracker: GenerativeTemplate
    clip: ClipTemplate
    levels: list[Level]
    prior: PosePrior
    visible: NDArray[np.bool_]

    def sought(self, pose: Poses, covariance: Array, coarsest: int) -> Poses:
        """Turn, place and the Gaussian's middle, with outliers taken as they are in `pose`."""
        inlier = self._texels(pose, covariance).inlier
        likelihood = self._likelihood(inlier)
        return find_modes(likelihood, self.prior, pose, self.tracker.effective_pixels, coarsest).poses

    def covariance(self, pose: Poses, before: Array) -> Array:
        """`(n_bases, n_bases)`: of the Gaussian of the coefficients, where turn and place are known."""
        there = self._likelihood(self._texels(pose, before).inlier).equations(0, pose, np.zeros(1, np.int64))
        beta = self.tracker.effective_pixels / max(there.sums[0, 2], 1e-9)
        precision = beta * there.matrices[0] + np.diag(self.prior.precision)
        covariance: Array = np.linalg.inv(precision[RIGID:, RIGID:])
        return covariance

    def judged(self, pose: Poses, covariance: Array, sums: _FrameSums) -> tuple[_FrameSums, float, float]:
        """Sums with this frame's added, the share of the surface that shows the template, and its bound."""
        texels = self._texels(pose, covariance)
        inlier, weight = texels.inlier, texels.weight
        observed, seen = self.tracker.surface.observe(self.levels, pose, self.visible[None])
        own = weight * inlier * seen[0]
        total, inliers = float(weight.sum()), float((weight * inlier).sum())
        # minus the divergence of the outliers' probabilities and of the Gaussian from what was known before
        chances = inlier * (texels.as_template - np.log(np.maximum(inlier, 1e-30)))
        chances += (1 - inlier) * (texels.as_outlier - np.log(np.maximum(1 - inlier, 1e-30)))
        morphs = self.prior.precision[RIGID:]
        divergence = 0.5 * (
            np.diag(covariance) @ morphs - np.linalg.slogdet(covariance * morphs)[1] - len(morphs)
        )
        bound = float(weight @ chances - divergence - self.prior.energy(pose, np.zeros(1, np.int64))[0][0])
        return (
            _FrameSums(
                sums.weight + own,
                sums.observed + own * observed[0],
                sums.squares + own * observed[0, 0].astype(np.float64) ** 2,
                sums.unsure + own * texels.unsure,
                sums.inliers + inliers,
                sums.total + total,
            ),
            inliers / max(total, 1e-9),
            bound,
        )

    def _likelihood(self, inlier: Array) -> TextureLikelihood:
        """The template, of which outliers say the less the surer they are."""
        noise = self.clip.noise / np.maximum(inlier, 1e-4)
        return TextureLikelihood(
            self.tracker.surface, self.levels, self.clip.template[None], noise.astype(np.float32)[None],
            self.visible[None],
        )  # fmt: skip

    def _texels(self, pose: Poses, covariance: Array) -> "_Texels":
        """How texels of the finest level look in a pose, and whether they are the template's."""
        surface, level = self.tracker.surface, self.levels[0]
        texels = surface.texels
        positions, rows = surface.rows(pose)
        values, areas = surface.sampled(level, pose, self.visible[None])
        value, area = values[0], np.maximum(areas[0], 0)  # off the picture
        corners = surface.used_texels.groups[texels.group_of_texel]
        places = np.einsum("na,nac->nc", texels.weights, positions[0][corners]) + texels.offsets
        across, down = _slopes(level.image, places).T
        shapes = rows[0][..., RIGID : RIGID + len(covariance)].astype(np.float64)
        moves = sum(texels.weights[:, corner, None, None] * shapes[corners[:, corner]] for corner in range(3))
        slopes = across[:, None] * moves[:, 0] + down[:, None] * moves[:, 1]
        unsure = np.einsum("nk,kl,nl->n", slopes, covariance, slopes)
        noise = self.clip.noise.astype(np.float64)
        error = value.astype(np.float64) - self.clip.template[0]
        as_template = np.log1p(-self.clip.outliers) - 0.5 * (
            np.log(2 * np.pi * noise) + (error**2 + unsure) / noise
        )
        as_outlier = np.log(self.clip.outliers / N_GREYS)
        weight: Array = area.astype(np.float64)
        weight *= self.tracker.effective_pixels / max(float(area.sum()), 1e-9)
        inlier = 1 / (1 + np.exp(np.clip(as_outlier - as_template, -50, 50)))
        return _Texels(weight, unsure, as_template, as_outlier, inlier)


def _slopes(image: NDArray[np.float32], places: Array) -> Array:
    """`(n, 2)`: slopes across and down of the bilinear interpolant at or nearest to `places` `(n, 2)`."""
    corner = np.clip(np.floor(places).astype(np.int64), 0, np.array(image.shape[::-1]) - 2)
    x, y = np.clip(places - corner, 0, 1).T
    column, row = corner.T
    cells = [image[row + a, column + b] for a in (0, 1) for b in (0, 1)]
    across = (1 - y) * (cells[1] - cells[0]) + y * (cells[3] - cells[2])
    down = (1 - x) * (cells[2] - cells[0]) + x * (cells[3] - cells[1])
    return np.stack([across, down], axis=1)


@dataclass(frozen=True, eq=False)
class _Texels:
    """Texels in a frame, each `(n_texels,)`.

    Parameters
    ----------
    weight
        effective pixels that a texel is worth.
    unsure
        squared grey levels that the shape's uncertainty adds to it.
    as_template, as_outlier
        log of its density times what was known before, if it is the template's and if it is not.
    inlier
        probability of the former.
    """

    weight: Array
    unsure: Array
    as_template: Array
    as_outlier: float
    inlier: Array
