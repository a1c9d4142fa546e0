"""Pixels that an object covers, and the background behind it: terms of G-flow eq. (17) and (18).

Densities are of raw grey values, relative to the uniform density: divided by its local mean, a background
would change with the object's position. The object's density, of y' = 128 y / (m + 5), is converted to raw
values by 128 / (m + 5).

The exact form of eq. (2) and (4) has a map an expert. Its Kalman filter is that of the texels, eq. (10) to
(12), with a gain of 0 where the object hides the pixel.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Shape
from ...models.core.pictures import grey_of
from ...models.core.short_repr import Rows, short_repr
from ...models.face.morphable_model import MorphableModel, Poses
from ...models.face.surface import Region, covered, visible
from ...models.numerics.threads import over_bands
from ...models.pixels.background import ODDS_STEPS
from ...models.pixels.layers import Layer, LayerStack
from ...models.pixels.pixel_labels import PixelMessage
from . import kernels
from .texture_likelihood import (
    DARKEST,
    FINE_LIGHT_REACH,
    MIDDLE_GREY,
    UNKNOWN_VARIANCE,
    TexturedObject,
    TextureLikelihood,
    blurred,
)

Array = NDArray[np.float64]
Map = NDArray[np.float32]

TRUST_TIME = 0.3  # s: time constant of the trust in a pixel's background
UNSEEN = -1.0  # trust in the background of a pixel hidden from the beginning, which counts as 0
LOUDEST = 3.0  # nats of a pixel for or against an edge, at most: more would bias the edge's position
INDEPENDENT = 0.3  # share of these nats that counts, since errors of neighbouring pixels are correlated

N_GREYS = 256.0

TONE_WIDTH = 4.0  # grey levels: standard deviation by which the histogram of an object is smoothed
OTHER_TONES = 0.2  # share of an object's pixels near its outline of uniform grey value


@dataclass(frozen=True, eq=False)
class BackgroundContrast:
    """Contrast of a frame with the background, one for all experts or one for each."""

    region: Region  # of the picture, outside of which the background is unknown
    log_ratio: Map  # `(n_maps, height, width)` float32: background over uniform density, nats times `trust`
    trust: Map  # `(n_maps, height, width)` float32, from 0, unknown, to 1
    border: Map  # `(n_maps, height, width)` float32: background over the object's tones, tempered nats
    # `(height, width)` float32 of the whole picture: see `units`
    unit: Map
    everywhere: Array  # `(n_maps,)`: sum of `log_ratio` over the whole picture, where there is a map for each

    @classmethod
    def of(cls, region: Region, ratio: Map, trust: Map, tones: Map, unit: Map, everywhere: Array) -> Self:
        """Return the contrast by the log `ratio` of background and uniform density, `(n_maps, height, width)`
        of the region, and that of the object's `tones`, `(height, width)` (see `tone_densities`)."""
        border = INDEPENDENT * trust * np.clip(ratio - tones, -LOUDEST, LOUDEST)
        return cls(region, trust * ratio, trust, border.astype(np.float32), unit, everywhere)


@dataclass(frozen=True, eq=False)
class OccludedBackground:
    """A background and the surface of the object that occludes it."""

    contrast: BackgroundContrast
    surface: TexturedObject  # texels over the whole mesh
    # `(n_experts, n_texels)`: texels in front, grazing ones included; constant during a search
    covering: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), np.bool_))

    def around(self, poses: Poses) -> "OccludedBackground":
        """Return this background with the texels that cover it in one pose an expert."""
        model = self.surface.model
        covering = visible(model.positions(poses), model.triangles, self.surface.texels, facing=0.0)
        return replace(self, covering=covering)

    def hidden_contrast(self, poses: Poses, owner: NDArray[np.int64]) -> Array:
        """Return the background's nats on the pixels that the object covers, `(n,)`."""
        contrast = self.contrast
        return _integral(self.surface, poses, owner, self.covering, contrast.log_ratio, contrast.region)

    def everywhere(self, owner: NDArray[np.int64]) -> Array:
        """Return the background's nats on the whole picture, `(n,)`; 0 if all experts share it."""
        whole = self.contrast.everywhere
        return whole[owner] if len(whole) > 1 else np.zeros(len(owner))

    def trusted_area(self, likelihood: TextureLikelihood, poses: Poses, owner: NDArray[np.int64]) -> Array:
        """Return the area under the visible texture with a known background, `(n,)` px squared."""
        return _integral(
            likelihood.surface, poses, owner, likelihood.visible, self.contrast.trust, self.contrast.region
        )


def _integral(
    surface: TexturedObject,
    poses: Poses,
    owner: NDArray[np.int64],
    on: NDArray[np.bool_],
    map_: Map,
    region: Region,
) -> Array:
    """Return the integral of a map of the region over the texels that are `on` `(n_experts, n_texels)`."""
    sums = np.empty(len(poses))
    positions = surface.positions(poses) - np.array([region.left, region.top], np.float32)

    def work(a: int, b: int) -> None:
        kernels.map_sums(map_, surface.used_texels, on, owner[a:b], positions[a:b], sums[a:b])

    over_bands(work, len(poses))
    return sums


def units(image: NDArray[np.uint8], size: float, *, local_mean: bool) -> Map:
    """Return log(256 dy'/dy), which makes a log density of y' one of y over uniform, `(height, width)`."""
    grey = grey_of(image)
    if not local_mean:
        return np.full(grey.shape, np.log(N_GREYS), np.float32)
    mean = blurred(grey.astype(np.float32), FINE_LIGHT_REACH * size)
    unit: Map = np.log(np.float32(N_GREYS * MIDDLE_GREY) / (mean + np.float32(DARKEST)))
    return unit


@dataclass(frozen=True, eq=False)
class SharedBackground:
    """Background of another chain, by its message to `PixelLabels`."""

    message: PixelMessage  # of the others to the feature, with image and background

    @cached_property
    def ratio(self) -> Map:
        """Log density of the background over the uniform one, clipped, `(height, width)` float32."""
        background, subtraction = self.message.background, self.message.subtraction
        assert background is not None
        assert subtraction is not None
        prior = np.log(background.prior) - np.log1p(-background.prior)
        odds: Map = subtraction.log_odds.reshape(self.message.size).astype(np.float32)
        odds *= np.float32(1 / ODDS_STEPS)
        odds -= np.float32(prior)
        return odds

    def contrast(self, trust: Map, region: Region, tones: Map, unit: Map) -> BackgroundContrast:
        """Return the contrast in the region; `trust` is of the whole picture."""
        its_trust = np.maximum(trust[region.window], 0)[None]
        return BackgroundContrast.of(
            region, self.ratio[region.window][None], its_trust, tones, unit, np.zeros(1)
        )

    def trust_after(self, trust: Map, hidden: NDArray[np.bool_], region: Region, elapsed: float) -> Map:
        """Update the trust in each pixel with a picture, `elapsed` s after the last one.

        Trust rises where the prediction was right and falls where it was wrong; pixels of the region that may
        be `hidden` by the object keep theirs. What the object hid at first, `UNSEEN`, stays unknown until a
        pixel differs from the background's prediction, which may be the object itself. Where the background
        has no prediction, it cannot have learned the object.
        """
        right = self.ratio > 0
        after: Map = trust - np.float32(np.expm1(-elapsed / TRUST_TIME)) * (right - trust)
        after = np.where(trust < 0, np.where(right, trust, np.float32(0)), after)
        after[region.window][hidden] = trust[region.window][hidden]
        after[(after < 0) & (np.abs(self.ratio) < 1 / ODDS_STEPS)] = 0
        return after


def first_trust(hidden: NDArray[np.bool_], region: Region, size: tuple[int, int]) -> Map:
    """Return the first trust in a background of `size`, `hidden` by the object in the region."""
    trust = np.zeros(size, np.float32)
    trust[region.window][hidden] = UNSEEN
    return trust


def tone_densities(image: NDArray[np.uint8], object_: NDArray[np.bool_], region: Region) -> Map:
    """Return the log density of the object's grey values over uniform, at the pixels of the region.

    The density is the smoothed histogram of the pixels `object_` `(height, width)` of the region, some of the
    object's.
    """
    grey = grey_of(image[region.window])
    counts = np.bincount(grey[object_], minlength=256).astype(np.float32)
    density = cv2.GaussianBlur(counts[None], (0, 0), TONE_WIDTH, borderType=cv2.BORDER_REFLECT)[0]
    share = N_GREYS * density / max(float(density.sum()), 1e-9)
    log_density = np.log((1 - OTHER_TONES) * share + OTHER_TONES).astype(np.float32)
    densities: Map = log_density[grey]
    return densities


NOISE = 20.0  # squared grey levels: noise of a pixel, sigma_w^2
WANDERING = 25.0  # squared grey levels per second: change of a pixel's background, Psi_b
LEAST_RATIO = -9.0  # nats: least log ratio of a pixel, since anything may come before the background


@short_repr
@dataclass(frozen=True, eq=False)
class ExpertBackground(Rows):
    """Background map of every expert, a Gaussian a pixel."""

    mean: Annotated[Map, Shape("n_experts", "height", "width")]  # raw grey levels
    variance: Annotated[Map, Shape("n_experts", "height", "width")]  # after the last picture

    @classmethod
    def unknown(cls, n_experts: int, size: tuple[int, int]) -> Self:
        """Return unseen maps of `size` `(height, width)`."""
        shape = (n_experts, *size)
        return cls(np.zeros(shape, np.float32), np.full(shape, UNKNOWN_VARIANCE, np.float32))

    def contrast(
        self, image: NDArray[np.uint8], region: Region, tones: Map, unit: Map, elapsed: float
    ) -> BackgroundContrast:
        """Return the contrast in the region, `elapsed` s after the last picture.

        Trust in a pixel is the share by which its variance is below that of an unseen one.
        """
        grey, n = grey_of(image), len(self.mean)
        ratio, trust = np.empty((2, n, region.height, region.width), np.float32)
        everywhere = np.empty(n)

        def work(a: int, b: int) -> None:
            kernels.compare_with_maps(
                grey, self.mean[a:b], self.variance[a:b], region, _noise(elapsed), np.float32(LEAST_RATIO),
                ratio[a:b], trust[a:b], everywhere[a:b],
            )  # fmt: skip

        over_bands(work, n)
        return BackgroundContrast.of(region, ratio, trust, tones, unit, everywhere)

    def updated(
        self,
        image: NDArray[np.uint8],
        parents: NDArray[np.int64],
        hidden: NDArray[np.uint8],
        region: Region,
        elapsed: float,
    ) -> Self:
        """Update the maps of the children of `parents` with a picture, `elapsed` s after the last one.

        Pixels that are `hidden` `(n_experts, height, width)` in the region keep their mean.
        """
        grey, n = grey_of(image), len(parents)
        mean, variance = np.empty((2, n, *grey.shape), np.float32)

        def work(a: int, b: int) -> None:
            kernels.update_maps(
                grey,
                self.mean,
                self.variance,
                parents[a:b],
                hidden[a:b],
                region,
                _noise(elapsed),
                mean[a:b],
                variance[a:b],
            )

        over_bands(work, n)
        return replace(self, mean=mean, variance=variance)


def _noise(elapsed: float) -> kernels.MapNoise:
    change = WANDERING * elapsed
    return kernels.MapNoise(np.float32(NOISE), np.float32(change), np.float32(UNKNOWN_VARIANCE))


MARGIN = 4  # px about the object in which its model may be wrong and the background is not learned
LEAST_SHARE = 1e-3  # weight of the experts that cover a pixel from which on it may be covered
STRENGTH = 100.0  # prior odds of the tracked object over something unknown


@dataclass(frozen=True, eq=False)
class Coverage:
    """Pixels that an object covers."""

    region: Region  # contains the object, with a margin
    # `(n_experts, height, width)` of the region: 1 where an expert's object covers the pixel
    inside: NDArray[np.uint8]
    share: Map  # `(height, width)` float32 of the region: probability that the object covers the pixel

    @classmethod
    def of(
        cls,
        model: MorphableModel,
        poses: Poses,
        weights: NDArray[np.float64],
        size: tuple[int, int],
        margin: float = 2 * MARGIN,
    ) -> "Coverage":
        """Return the coverage by experts in `poses`, in a picture of `size`, with a `margin` in px."""
        positions = model.project(poses)
        region = Region.around(positions, margin, size)
        inside = covered(positions, model.triangles, region)
        share = np.tensordot(weights.astype(np.float32), inside.astype(np.float32), 1)
        return cls(region, inside, np.asarray(share, np.float32))

    @cached_property
    def hidden(self) -> NDArray[np.bool_]:
        """Pixels that may be covered, with a margin for the model's error, `(height, width)`."""
        return dilate(self.share > LEAST_SHARE)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """Pixels of the object well inside its outline, `(height, width)`."""
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN + 1, 2 * MARGIN + 1))
        inner: NDArray[np.bool_] = cv2.erode((self.share > 0.5).astype(np.uint8), disc) > 0
        return inner

    def layers(self, trust: Map | None) -> LayerStack:
        """Return the layers of the message to the pixels: the object, and a ghost where it was before.

        The ghost covers pixels without `trust` in the background (of the whole picture) that the object has
        left: there the background has learned the object itself. Layers have no colours: textures are grey
        and without the light.
        """
        mask = cv2.dilate(self.share, np.ones((3, 3), np.uint8))
        layer = Layer(
            self.region.top, self.region.left, np.asarray(mask, np.float32), None, strength=STRENGTH
        )
        if trust is None:
            return LayerStack((layer,))
        rows, columns = np.flatnonzero((trust <= 0).any(axis=1)), np.flatnonzero((trust <= 0).any(axis=0))
        if not len(rows):
            return LayerStack((layer,))
        top, left = int(rows[0]), int(columns[0])
        free = trust[top : rows[-1] + 1, left : columns[-1] + 1] == 0
        hidden = np.zeros(trust.shape, np.bool_)
        hidden[self.region.window] = self.hidden
        free &= ~hidden[top : rows[-1] + 1, left : columns[-1] + 1]
        if not free.any():
            return LayerStack((layer,))
        return LayerStack((layer, Layer(top, left, free.astype(np.float32), None, ghost=True)))


def dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask dilated by `MARGIN` px."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN + 1, 2 * MARGIN + 1))
    wide: NDArray[np.bool_] = cv2.dilate(mask.astype(np.uint8), disc) > 0
    return wide
