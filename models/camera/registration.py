"""Registration of a frame with a picture of the scene: by which affine map the one shows the other.

Gauss-Newton steps over the points with the strongest gradients, from coarse to fine (Lucas and Kanade 1981,
with Student's t for what moves by itself). Both pictures are band-passed first, so that smooth changes of
light do not matter, and one contrast is free.
"""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from .affine_map import UNKNOWNS, AffineMap
from .kernels import registration as kernels

Numbers = NDArray[np.float64]
Floats = NDArray[np.float32]

POINTS = 3000
"""By which pictures are registered, at most, on each level."""

COARSEST, FINEST = 48, 640
"""px, the least length of a side of the coarsest level, and the largest one of the finest: half as fine is
half as exact, and a fortieth of a pixel."""

THINNEST = 16
"""px, of a side of the finest level, below which a picture is too thin to be registered."""

LOCAL_MEAN = 15
"""px, side of the square about a pixel whose mean is taken off its value."""

STEPS, SMALL = 12, 0.01
"""Gauss-Newton steps at most on each level, and px of a step after which there is no other."""

LEAST_NOISE = 1.0
"""Grey levels: residuals are not smaller than that for long, rounding alone makes a third."""

LARGEST = 30.0
"""Grey levels: a residual that is larger is no worse."""

WORTH = 0.25
"""Independent observations in one point's: band-passed neighbours share their noise."""

OUTSIDE = 1e9
"""Residual of a point that the frame does not show."""


@dataclass(frozen=True, eq=False)
class Level:
    """A level of the pyramid of the scene's picture: the points by which frames are registered.

    Parameters
    ----------
    scale
        px of the picture in one of this level's.
    places, about
        `(n, 2)` float32: in px of this level, and from the picture's middle in units of its radius.
    values, gradients
        `(n,)` and `(n, 2)` float32 of the band-passed picture.
    """

    scale: float
    places: Floats
    about: Floats
    values: Floats
    gradients: Floats

    @classmethod
    def of(cls, picture: Floats, scale: float, size: tuple[int, int]) -> Self:
        """The points of a band-passed picture, `scale` times as small as one of `size`."""
        across, down = (
            cv2.Sobel(picture, cv2.CV_32F, dx, dy, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
            for dx, dy in ((1, 0), (0, 1))
        )
        height, width = picture.shape
        cell = max(int(np.ceil(np.sqrt(height * width / POINTS))), 3)
        places = np.empty((height * width // cell**2 + 1, 2), np.float32)
        places = places[: kernels.strongest(across, down, cell, 2, places)]
        x, y = places.T.astype(np.intp)
        whole = AffineMap.identity(size)
        about = ((scale * places - np.array(whole.middle)) / whole.radius).astype(np.float32)
        return cls(scale, places, about, picture[y, x], np.column_stack([across[y, x], down[y, x]]))


@short_repr
@dataclass(frozen=True, eq=False)
class Registration:
    """Where a frame shows the scene, and how surely.

    Parameters
    ----------
    map
        the most likely one.
    covariance
        `(6, 6)` px^2 of its parameters (Laplace's approximation).
    explained
        share of the differences between frame and scene, where nothing is moved, that it takes away: near 1
        when all that is not as it was has moved by this map, 0 when the map is none or does not help.
    correlation
        of what the frame shows at the mapped points with what the scene does, values beyond their usual size
        cut off, so that things which move count by their number: by chance it is below 0.1.
    """

    map: AffineMap
    covariance: Numbers
    explained: float
    correlation: float


@short_repr
class ScenePicture:
    """A picture of the scene, prepared so that frames can be registered with it.

    Parameters
    ----------
    grey
        `(height, width)` uint8 or float32.

    Raises
    ------
    ValueError
        if a side is below `THINNEST` px when the picture is as small as `FINEST`: nothing can be recognised.
    """

    def __init__(self, grey: NDArray[np.uint8] | Floats) -> None:
        self.size = (grey.shape[0], grey.shape[1])
        if is_thin(self.size):
            raise ValueError(
                f"camera: got pictures of {self.size[1]}x{self.size[0]} px, expected wider and higher ones "
                f"(neither side below {THINNEST} px when the longer one is {FINEST})"
            )
        self._bands = _pyramid(grey)
        # halves of odd sizes are rounded up, and keep the places of every other pixel
        finest = 2.0 ** round(np.log2(max(self.size) / max(self._bands[0].shape)))
        self._levels = [Level.of(band, finest * 2.0**k, self.size) for k, band in enumerate(self._bands)]

    def register(self, grey: NDArray[np.uint8], start: AffineMap) -> Registration:
        """Find the map by which a frame shows this scene.

        Parameters
        ----------
        grey
            `(height, width)` uint8.
        start
            near which the map is, within some 40 px; jumps without rotation may be longer.
        """
        bands = _pyramid(grey)
        parameters = self._nearest(bands, start.parameters)
        for band, level in zip(reversed(bands), reversed(self._levels), strict=True):
            parameters, information = _refined(band, level, parameters)
        places = self._levels[0]
        found, before = (_residuals(bands[0], places, each) for each in (parameters, np.zeros(UNKNOWNS)))
        inside = np.maximum(found, before) < OUTSIDE
        left, there = (_cost(np.where(inside, off, OUTSIDE)) for off in (found, before))
        explained = 1 - left / there if np.isfinite(left) and there > 0 else 0.0
        correlation = _correlation(found + places.values, places.values, found < OUTSIDE)
        covariance = np.linalg.inv(information).astype(np.float64)
        return Registration(AffineMap(parameters, self.size), covariance, explained, correlation)

    def _nearest(self, bands: list[Floats], start: Numbers) -> Numbers:
        """The better one of where the map should be and a mere shift, as the coarsest level shows them."""
        level, band = self._levels[-1], bands[-1]
        window = cv2.createHanningWindow(band.shape[::-1], cv2.CV_32F)
        shift, _ = cv2.phaseCorrelate(self._bands[-1], band, window)
        shifted = np.array([shift[0], 0, 0, shift[1], 0, 0]) * level.scale
        costs = []
        for parameters in (start, shifted):
            refined, _ = _refined(band, level, parameters)
            costs.append((_cost(_residuals(band, level, refined)), refined))
        return min(costs, key=lambda each: each[0])[1]


def is_thin(size: tuple[int, int]) -> bool:
    """Whether pictures of `(height, width)` px are too small or too thin to be registered."""
    return min(size) < THINNEST * max(1.0, max(size) / FINEST)


def _pyramid(grey: NDArray[np.uint8] | Floats) -> list[Floats]:
    """Band-passed levels, the finest first."""
    while max(grey.shape) > FINEST:
        grey = cv2.pyrDown(grey)  # type: ignore[assignment]
    levels = [np.asarray(grey, np.float32)]
    while min(levels[-1].shape) >= 2 * COARSEST:
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), np.float32))
    return [_band_passed(level) for level in levels]


def _band_passed(grey: Floats) -> Floats:
    fine = cv2.GaussianBlur(grey, (5, 5), 1.2)
    side = (LOCAL_MEAN, LOCAL_MEAN)
    return np.asarray(fine - cv2.blur(fine, side), np.float32)


def _refined(band: Floats, level: Level, start: Numbers) -> tuple[Numbers, Numbers]:
    """Parameters after Gauss-Newton steps on a level, and their information."""
    parameters, contrast = start.copy(), 1.0
    information, vector = np.empty((7, 7)), np.empty(7)
    for _ in range(STEPS):
        off = _residuals(band, level, parameters, contrast)
        variance = _variance(off)
        kernels.normal_equations(
            off, level.values, level.gradients, level.about, variance, information, vector
        )
        information[np.diag_indices(7)] += 1e-3  # where nothing is to be seen, nothing moves
        step = np.linalg.solve(information, vector)
        parameters -= level.scale * step[:UNKNOWNS]
        contrast = float(np.clip(contrast - step[UNKNOWNS], 0.5, 2.0))
        if np.abs(step[:UNKNOWNS]).max() < SMALL:
            break
    schur = information[:6, :6] - np.outer(information[:6, 6], information[6, :6]) / information[6, 6]
    return parameters, WORTH * schur / (variance * level.scale**2)


def _residuals(band: Floats, level: Level, parameters: Numbers, contrast: float = 1.0) -> Numbers:
    off = np.empty(len(level.places))
    kernels.residuals(band, level.places, level.values, level.about, parameters / level.scale, contrast, off)
    return off


def _variance(off: Numbers) -> float:
    """Of the residuals of points that fit, squared grey levels, by the median of their sizes."""
    inside = np.abs(off[off < OUTSIDE])
    return float(max(1.4826 * np.median(inside), LEAST_NOISE)) ** 2 if len(inside) else LEAST_NOISE**2


def _cost(off: Numbers) -> float:
    """Mean size of the residuals, which outliers do not rule; infinite if the frame shows next to nothing."""
    inside = np.abs(off[off < OUTSIDE])
    return float(np.minimum(inside, LARGEST).mean()) if len(inside) > 0.2 * len(off) else np.inf


def _correlation(one: Numbers, other: Floats, among: NDArray[np.bool_]) -> float:
    if not among.any():
        return 0.0
    first, second = _cut(one[among]), _cut(other[among].astype(np.float64))
    scale = float(np.sqrt((first @ first) * (second @ second)))
    return float(first @ second) / scale if scale > 0 else 0.0


def _cut(values: Numbers) -> Numbers:
    usual = np.median(np.abs(values))
    return np.clip(values, -usual, usual)
