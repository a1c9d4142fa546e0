"""Registration of the frames of a moving camera with a picture of the scene, by an affine map.

Gauss-Newton over the points with the strongest gradients, from coarse to fine (Lucas and Kanade 1981, with
Student's t for objects that move by themselves). Both pictures are band-passed first, which removes smooth
changes of light; one contrast is estimated.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.gaussian_message import GaussianMessage
from ..core.pictures import grey_of
from ..core.short_repr import short_repr
from ..numerics.compiled import compiled

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Image = NDArray[np.uint8]
Value = TypeVar("Value", np.uint8, np.uint16, np.float32)

STEP_UNKNOWNS = 7  # the six of an affine map, and the contrast
ALL, SHIFTS = np.arange(STEP_UNKNOWNS), np.array([0, 3, 6])  # of these


@compiled
def strongest(across, down, cell, margin, places):
    """Find the largest gradient in each cell of the picture, `(n_cells, 2)` columns and rows."""
    height, width = across.shape
    number = 0
    for top in range(margin, height - margin - cell + 1, cell):
        for left in range(margin, width - margin - cell + 1, cell):
            best = np.float32(-1.0)
            for y in range(top, top + cell):
                for x in range(left, left + cell):
                    size = across[y, x] * across[y, x] + down[y, x] * down[y, x]
                    if size > best:
                        best = size
                        places[number, 0], places[number, 1] = x, y
            number += 1
    return number


@compiled
def residuals(image, places, values, about, parameters, contrast, off):
    """Write the image at the mapped places less `contrast` times `values`; 1e9 outside of the image.

    `about` `(n, 2)` are the places relative to the picture's middle in units of its radius.
    """
    height, width = image.shape
    for n in range(places.shape[0]):
        u, v = about[n, 0], about[n, 1]
        x = places[n, 0] + parameters[0] + parameters[1] * u + parameters[2] * v
        y = places[n, 1] + parameters[3] + parameters[4] * u + parameters[5] * v
        left, top = int(np.floor(x)), int(np.floor(y))
        if left < 0 or top < 0 or left + 1 >= width or top + 1 >= height:
            off[n] = 1e9
            continue
        fx, fy = x - left, y - top
        above = (1 - fx) * image[top, left] + fx * image[top, left + 1]
        below = (1 - fx) * image[top + 1, left] + fx * image[top + 1, left + 1]
        off[n] = (1 - fy) * above + fy * below - contrast * values[n]


@compiled
def normal_equations(off, values, gradients, about, variance, information, vector):
    """Write the normal equations of a Gauss-Newton step under Student's t (4 degrees)."""
    information[:] = 0.0
    vector[:] = 0.0
    row = np.empty(STEP_UNKNOWNS)
    for n in range(off.shape[0]):
        if off[n] >= 1e9:
            continue
        weight = 5.0 / (4.0 + off[n] * off[n] / variance)
        u, v = about[n, 0], about[n, 1]
        gx, gy = gradients[n, 0], gradients[n, 1]
        row[0], row[1], row[2] = gx, gx * u, gx * v
        row[3], row[4], row[5] = gy, gy * u, gy * v
        row[6] = -values[n]
        for i in range(STEP_UNKNOWNS):
            weighted = weight * row[i]
            vector[i] += weighted * off[n]
            for j in range(i, STEP_UNKNOWNS):
                information[i, j] += weighted * row[j]
    for i in range(STEP_UNKNOWNS):
        for j in range(i):
            information[i, j] = information[j, i]


UNKNOWNS = 6  # numbers of an affine map


@short_repr
@dataclass(frozen=True, eq=False)
class AffineMap:
    """Affine map from the scene's picture to a frame of the same size.

    A point x, with (u, v) = (x - middle) / radius, is seen at x + (p0 + p1 u + p2 v, p3 + p4 u + p5 v); the
    radius is half the picture's diagonal, so that all six parameters are in px.

    Parameters
    ----------
    parameters
        `(6,)` float64 px: p0 to p5.
    size
        `(height, width)` px of scene and frame.
    """

    parameters: Array
    size: tuple[int, int]

    @classmethod
    def identity(cls, size: tuple[int, int]) -> Self:
        """Return the map of a camera that has not moved."""
        return cls(np.zeros(UNKNOWNS), size)

    @classmethod
    def of(cls, matrix: Array, size: tuple[int, int]) -> Self:
        """Return the map whose `matrix` `(2, 3)` is given."""
        still = cls.identity(size)
        shift = matrix[:, :2] @ still.middle + matrix[:, 2] - still.middle
        return cls(np.column_stack([shift, (matrix[:, :2] - np.eye(2)) * still.radius]).reshape(-1), size)

    @property
    def middle(self) -> tuple[float, float]:
        """Middle of the picture (x, y), px."""
        return (self.size[1] - 1) / 2, (self.size[0] - 1) / 2

    @property
    def radius(self) -> float:
        """Half the diagonal, px."""
        return float(np.hypot(*self.size)) / 2

    @property
    def matrix(self) -> Array:
        """The same map as a matrix `(2, 3)` of points (x, y, 1)."""
        rows = self.parameters.reshape(2, 3)
        linear = np.eye(2) + rows[:, 1:] / self.radius
        middle = np.array(self.middle)
        return np.column_stack([linear, middle + rows[:, 0] - linear @ middle])

    @property
    def displacement(self) -> float:
        """Root mean square displacement over the picture, px."""
        shares = (np.array([self.size[1], self.size[0]]) / (2 * self.radius)) ** 2 / 3
        rows = self.parameters.reshape(2, 3) ** 2
        return float(np.sqrt((rows[:, 0] + rows[:, 1:] @ shares).sum()))

    def points(self, places: NDArray[np.float64]) -> Array:
        """Return the positions in the frame, px, of points `(..., 2)` of the scene."""
        matrix = self.matrix
        return places @ matrix[:, :2].T + matrix[:, 2]

    @property
    def inverse(self) -> Self:
        """The map from the frame to the scene."""
        return self.of(np.asarray(cv2.invertAffineTransform(self.matrix), np.float64), self.size)

    def after(self, first: Self) -> Self:
        """Return the map that is `first` followed by this one."""
        matrix = self.matrix[:, :2] @ first.matrix
        matrix[:, 2] += self.matrix[:, 2]
        return self.of(matrix, self.size)

    @property
    def scale(self) -> Array:
        """`(2,)`: by which widths and heights grow."""
        return np.asarray(np.hypot(*self.matrix[:, :2]))

    def boxes(self, boxes: Array) -> Array:
        """Return boxes `(n, 4)` (foot x, foot y, width, height) in the frame: upright, middles mapped."""
        sides = boxes[:, 2:] * self.scale
        up = np.array([0.0, 0.5])
        middles = self.points(boxes[:, :2] - up * boxes[:, 2:] - 0.5) + 0.5
        return np.hstack([middles + up * sides, sides])

    def warp_to_scene(self, image: NDArray[Value], beyond: NDArray[Value]) -> NDArray[Value]:
        """Warp a frame's image to the scene; `beyond` fills what the frame does not show."""
        out = beyond.copy()
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        cv2.warpAffine(
            image, self.matrix, self.size[::-1], dst=out, flags=flags, borderMode=cv2.BORDER_TRANSPARENT
        )
        return out

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Pixels of the scene that lie in the frame, `(height, width)`."""
        return self.mask_to_scene(np.ones(self.size, np.bool_))

    def mask_to_scene(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Warp a mask `(height, width)` of the frame to the scene; false where the frame does not show it."""
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        seen = cv2.warpAffine(mask.astype(np.uint8), self.matrix, self.size[::-1], flags=flags)
        return np.asarray(seen, np.bool_)

    def warp_to_frame(self, mask: NDArray[Value], flags: int = cv2.INTER_NEAREST) -> NDArray[Value]:
        """Warp a map of the scene `(height, width)` to the frame; 0 outside of the scene."""
        return np.asarray(cv2.warpAffine(mask, self.matrix, self.size[::-1], flags=flags), mask.dtype)


POINTS = 3000  # points by which pictures are registered on each level, at most
COARSEST, FINEST = 48, 640  # px: sides of the coarsest and the finest level; accuracy falls with the latter
THINNEST = 16  # px: shortest side of the finest level that can be registered
SHIFTED = 0.2  # of the picture: how far off a frame is looked for along either axis
LOCAL_MEAN = 15  # px: side of the square whose mean is subtracted
STEPS, SMALL = 12, 0.01  # most Gauss-Newton steps on each level, and px of a step that ends them
LEAST_NOISE = 1.0  # grey levels: least standard deviation of residuals; rounding alone makes a third
LARGEST = 30.0  # grey levels: larger residuals are cut off
WORTH = 0.25  # independent observations in one point's, since band-passed neighbours share noise
OUTSIDE = 1e9  # residual of a point outside the frame


@dataclass(frozen=True, eq=False)
class Level:
    """Points by which frames are registered on a level of the pyramid, of `scale` px a pixel."""

    scale: float
    places: Floats
    about: Floats
    values: Floats
    gradients: Floats

    @classmethod
    def of(
        cls, picture: Floats, scale: float, size: tuple[int, int], without: NDArray[np.bool_] | None
    ) -> Self:
        """Return the points of a band-passed picture, `scale` times as small as one of `size`.

        There are none where `without`, of this size, is true.
        """
        across, down = (
            cv2.Sobel(picture, cv2.CV_32F, dx, dy, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
            for dx, dy in ((1, 0), (0, 1))
        )
        height, width = picture.shape
        cell = max(int(np.ceil(np.sqrt(height * width / POINTS))), 3)
        places = np.empty((height * width // cell**2 + 1, 2), np.float32)
        places = places[: strongest(across, down, cell, 2, places)]
        if without is not None:
            x, y = np.rint(scale * places).T.astype(np.intp)
            places = places[~without[np.minimum(y, size[0] - 1), np.minimum(x, size[1] - 1)]]
        x, y = places.T.astype(np.intp)
        whole = AffineMap.identity(size)
        about = ((scale * places - np.array(whole.middle)) / whole.radius).astype(np.float32)
        return cls(scale, places, about, picture[y, x], np.column_stack([across[y, x], down[y, x]]))


@short_repr
@dataclass(frozen=True, eq=False)
class Registration:
    """Estimated map of a frame, its covariance and its fit.

    Parameters
    ----------
    map, covariance
        the most likely one, and `(6, 6)` px^2 of its parameters (Laplace's approximation).
    explained
        share by which the map lowers the difference of frame and scene under the identity: 1 if the map
        explains all of it, 0 if it does not help.
    correlation
        of frame and scene at the mapped points, values beyond their median size cut off; below 0.1 by chance.
    """

    map: AffineMap
    covariance: Array
    explained: float
    correlation: float


@short_repr
class ScenePicture:
    """Picture of the scene, prepared for the registration of frames.

    `grey` is `(height, width)` uint8 or float32; where `without`, of the same shape, is true, something moves
    by itself. Raises `ValueError` if it is too thin.
    """

    def __init__(self, grey: NDArray[np.uint8] | Floats, without: NDArray[np.bool_] | None = None) -> None:
        self.size = (grey.shape[0], grey.shape[1])
        if is_thin(self.size):
            raise ValueError(
                f"camera: got pictures of {self.size[1]}x{self.size[0]} px, expected wider and higher ones "
                f"(neither side below {THINNEST} px when the longer one is {FINEST})"
            )
        bands = _pyramid(grey)
        # halves of odd sizes are rounded up, and keep the places of every other pixel
        finest = 2.0 ** round(np.log2(max(self.size) / max(bands[0].shape)))
        self._levels = [Level.of(band, finest * 2.0**k, self.size, without) for k, band in enumerate(bands)]
        self._coarsest = bands[-1]
        if without is not None:
            hidden = cv2.resize(
                without.astype(np.float32), bands[-1].shape[::-1], interpolation=cv2.INTER_AREA
            )
            self._coarsest = np.asarray(bands[-1] * (hidden == 0), np.float32)

    def register(self, grey: NDArray[np.uint8], start: AffineMap) -> Registration:
        """Estimate the map of a frame, whose shift from `start` may be a fifth of the picture."""
        bands = _pyramid(grey)
        parameters = self._nearest(bands, start.parameters)
        finer = max(len(bands) - 1, 1)  # on the coarsest level, little speaks of more than the shift
        for band, level in zip(bands[:finer][::-1], self._levels[:finer][::-1], strict=True):
            parameters, information = _refined(band, level, parameters)
        places = self._levels[0]
        found, before = (_residuals(bands[0], places, each) for each in (parameters, np.zeros(UNKNOWNS)))
        inside = np.maximum(found, before) < OUTSIDE
        left, there = (_cost(np.where(inside, off, OUTSIDE)) for off in (found, before))
        explained = 1 - left / there if np.isfinite(left) and there > 0 else 0.0
        correlation = _correlation(found + places.values, places.values, found < OUTSIDE)
        covariance = np.linalg.inv(information).astype(np.float64)
        return Registration(AffineMap(parameters, self.size), covariance, explained, correlation)

    def _nearest(self, bands: list[Floats], start: Array) -> Array:
        """Return the better one of `start` and a cross-correlated shift from it on the coarsest level."""
        level, band = self._levels[-1], bands[-1]
        size = (band.shape[0], band.shape[1])
        by_start = AffineMap(start / level.scale, size).warp_to_scene(band, np.zeros_like(band))
        rows, columns = (round(SHIFTED * side) for side in size)
        middle = self._coarsest[rows : size[0] - rows, columns : size[1] - columns]
        agreement = cv2.matchTemplate(by_start, middle, cv2.TM_CCORR_NORMED)
        down, right = np.unravel_index(np.argmax(agreement), agreement.shape)
        shifted = start + np.array([right - columns, 0, 0, down - rows, 0, 0]) * level.scale
        costs = []
        for parameters in (start, shifted):
            refined, _ = _refined(band, level, parameters, SHIFTS)
            costs.append((_cost(_residuals(band, level, refined)), refined))
        return min(costs, key=lambda each: each[0])[1]


def is_thin(size: tuple[int, int]) -> bool:
    """Return whether pictures of `(height, width)` px are too small or too thin to be registered."""
    return min(size) < THINNEST * max(1.0, max(size) / FINEST)


def _pyramid(grey: NDArray[np.uint8] | Floats) -> list[Floats]:
    """Return band-passed levels, the finest first."""
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


def _refined(band: Floats, level: Level, start: Array, free: NDArray[np.intp] = ALL) -> tuple[Array, Array]:
    """Return parameters after Gauss-Newton steps of those that are `free`, and the information of all."""
    parameters, contrast = start.copy(), 1.0
    information, vector = np.empty((7, 7)), np.empty(7)
    for _ in range(STEPS):
        off = _residuals(band, level, parameters, contrast)
        variance = _variance(off)
        normal_equations(off, level.values, level.gradients, level.about, variance, information, vector)
        information[np.diag_indices(7)] += 1e-3  # keeps a picture without texture regular
        step = np.zeros(STEP_UNKNOWNS)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], vector[free])
        parameters -= level.scale * step[:UNKNOWNS]
        contrast = float(np.clip(contrast - step[UNKNOWNS], 0.5, 2.0))
        if np.abs(step[:UNKNOWNS]).max() < SMALL:
            break
    schur = information[:6, :6] - np.outer(information[:6, 6], information[6, :6]) / information[6, 6]
    return parameters, WORTH * schur / (variance * level.scale**2)


def _residuals(band: Floats, level: Level, parameters: Array, contrast: float = 1.0) -> Array:
    off = np.empty(len(level.places))
    residuals(band, level.places, level.values, level.about, parameters / level.scale, contrast, off)
    return off


def _variance(off: Array) -> float:
    """Return the variance of residuals, squared grey levels, by their median size."""
    inside = np.abs(off[off < OUTSIDE])
    return float(max(1.4826 * np.median(inside), LEAST_NOISE)) ** 2 if len(inside) else LEAST_NOISE**2


def _cost(off: Array) -> float:
    """Return the mean size of the residuals, cut off; infinite if the frame shows too few points."""
    inside = np.abs(off[off < OUTSIDE])
    return float(np.minimum(inside, LARGEST).mean()) if len(inside) > 0.2 * len(off) else np.inf


def _correlation(one: Array, other: Floats, among: NDArray[np.bool_]) -> float:
    if not among.any():
        return 0.0
    first, second = _cut(one[among]), _cut(other[among].astype(np.float64))
    scale = float(np.sqrt((first @ first) * (second @ second)))
    return float(first @ second) / scale if scale > 0 else 0.0


def _cut(values: Array) -> Array:
    usual = np.median(np.abs(values))
    return np.clip(values, -usual, usual)


LEAST_CORRELATION = 0.25  # of a registered frame; 0.1 happens by chance
_CAMERA = np.zeros(1, np.int64)  # identity of the camera in Gaussian messages


@short_repr
@dataclass(frozen=True, eq=False)
class View:
    """Gaussian message over the parameters of the map from the scene to the frame.

    A frame that is farther away than `room`, or that nothing is known of while the camera is `lost`, begins a
    new scene: its own view. The chains of this scene take part by mapping their states to it at the end of
    their update (`begins`).

    Parameters
    ----------
    size
        `(height, width)` px.
    where
        of the map; uniform without information.
    scene
        `(height, width[, 3])` float32: picture of the scene, from the chain that models the camera.
    unknown
        `(height, width)` bool: where objects have hidden the scene until now.
    room
        px, root mean square displacement beyond which a frame is no view of this scene.
    least
        correlation from which on a frame is found.
    lost
        whether the scene is given up if the frame is not found in it.
    correlation
        of frame and scene; 0 without a frame.
    begins
        the frame's own image, if it is the scene from now on.
    """

    size: tuple[int, int]
    where: GaussianMessage
    scene: NDArray[np.float32] | None = None
    unknown: NDArray[np.bool_] | None = None
    room: float = np.inf
    least: float = 0.0
    lost: bool = False
    correlation: float = 0.0
    begins: Image | None = None

    @classmethod
    def predicted(
        cls,
        mean: Array,
        covariance: Array,
        scene: NDArray[np.float32],
        unknown: NDArray[np.bool_] | None = None,
        room: float = np.inf,
        least: float = 0.0,
        *,
        lost: bool = False,
    ) -> Self:
        """Return a density of the map, with the scene for the registration."""
        where = GaussianMessage.from_moments(_CAMERA, mean[None], covariance[None])
        return cls((scene.shape[0], scene.shape[1]), where, scene, unknown, room, least, lost)

    def __mul__(self, other: Self) -> Self:
        return replace(
            self,
            where=self.where * other.where,
            scene=self.scene if other.scene is None else other.scene,
            unknown=self.unknown if other.unknown is None else other.unknown,
            correlation=max(self.correlation, other.correlation),
            begins=self.begins if other.begins is None else other.begins,
        )

    @cached_property
    def map(self) -> AffineMap:
        """The most likely map."""
        return AffineMap(self.where.marginal(0)[0], self.size)

    @property
    def is_found(self) -> bool:
        """Whether the frame resembles the scene."""
        return self.correlation >= max(self.least, LEAST_CORRELATION)

    @property
    def covariance(self) -> Array:
        """Covariance of the map's parameters, `(6, 6)` px^2."""
        return self.where.marginal(0)[1]

    def box_variances(self, boxes: Array) -> Array:
        """Return `(n, 4)` px^2, what the map is unsure of boxes `(n, 4)` of the scene in the frame."""
        radius, spread = self.map.radius, self.covariance
        feet = np.column_stack([np.ones(len(boxes)), (boxes[:, :2] - np.array(self.map.middle)) / radius])
        # its middle is mapped, half a height above the foot, whose row grows as the height does
        middles = feet - np.outer(boxes[:, 3] / (2 * radius), [0, 0, 1])
        x, y = (
            ((middles @ spread[:3, :3]) * middles).sum(axis=1),
            ((feet @ spread[3:, 3:]) * feet).sum(axis=1),
        )
        return np.column_stack([x, y, (boxes[:, 2:] / radius) ** 2 * spread.diagonal()[[1, 5]]])

    @cached_property
    def hidden(self) -> NDArray[np.bool_]:
        """Pixels of the scene that the frame does not show, `(height, width)`."""
        return ~self.map.shown

    def register(self, image: Image, without: NDArray[np.bool_] | None = None) -> tuple[Self, Image]:
        """Return the likelihood of the map, and the image warped to the scene.

        The likelihood is Laplace's approximation, 1 at its peak; uniform if the frame does not correlate with
        the scene. The image is warped by the most likely map, prediction included; the scene fills what the
        frame does not show. Nothing is compared `without` `(height, width)`. Raises `ValueError` without a
        scene.
        """
        if self.scene is None:
            raise ValueError("view: got no scene, expected one by which frames are found")
        grey = self.scene if self.scene.ndim == 2 else cv2.cvtColor(self.scene, cv2.COLOR_BGR2GRAY)
        if self.unknown is not None:
            without = self.unknown if without is None else without | self.unknown
        found = ScenePicture(np.asarray(grey, np.float32), without).register(grey_of(image), self.map)
        likelihood = replace(
            self, where=GaussianMessage.uniform(UNKNOWNS), scene=None, correlation=found.correlation
        )
        leaves = self.lost
        if likelihood.is_found:
            leaves = found.map.displacement > self.room
            information = np.linalg.inv(found.covariance).astype(np.float64)
            vector = information @ found.map.parameters
            log_scale = np.array([-0.5 * vector @ found.map.parameters])
            where = GaussianMessage(_CAMERA, information[None], vector[None], log_scale)
            likelihood = replace(likelihood, where=where)
        if leaves:
            likelihood = replace(likelihood, begins=image)
        beyond = np.clip(np.rint(self.scene), 0, 255).astype(np.uint8)
        return likelihood, (self * likelihood).map.warp_to_scene(image, beyond)
