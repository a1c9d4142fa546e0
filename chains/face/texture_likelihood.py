"""Likelihood of poses given a picture, with the light removed, and the experts' textures."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.pictures import grey_of
from ...models.face.morphable_model import RIGID, MorphableModel, Poses
from ...models.face.surface import SurfaceTexels, visible
from ...models.numerics.compiled import LANES
from ...models.numerics.threads import over_bands, side_by_side
from . import kernels

Array = NDArray[np.float64]
Map = NDArray[np.float32]


MIDDLE_GREY = 128.0
UNKNOWN_VARIANCE = 60.0**2  # squared grey levels: of a texel or a background that was never seen
# Smoothing by which generated faces under moving light were tracked best:
DARKEST = 5.0  # grey levels added to the local mean, so that noise of black regions is not amplified
FINE_LIGHT_REACH = 0.1  # standard deviation of the local mean on the finest level, in sizes of the object
COARSE_LIGHT_REACH = 0.25  # the same on the other levels, whose textures are wider
SMOOTHING = (0.0175, 0.05, 0.125)  # standard deviations by level, fine to coarse, in sizes of the object


class Level(NamedTuple):
    """One level of a picture."""

    image: Map  # `(height, width)` float32 grey, its rows one after the other
    # px of the level per px of the picture: pixel x of the picture is at x scale + (scale - 1) / 2
    scale: float


def image_pyramid(image: NDArray[np.uint8], size: float, *, n_levels: int, local_mean: bool) -> list[Level]:
    """Return the levels of a picture, fine to coarse; each is half as large as the one before.

    With `local_mean` grey values are divided by their local mean, y <- 128 y / (mean + 5), which removes
    light that changes slowly over the object; `size` px, that of the object, scales the mean's reach and the
    smoothing. `image` is uint8, grey or BGR.

    Raises `ValueError` if the coarsest level would have less than two px either way.
    """
    least = 2 * 2 ** (n_levels - 1)
    if min(image.shape[:2]) < least:
        raise ValueError(f"image: got {image.shape[:2]}, expected at least {least} px either way")
    raw = grey_of(image).astype(np.float32)

    def fine() -> list[Level]:
        picture = divide_by_local_mean(raw, FINE_LIGHT_REACH * size) if local_mean else raw
        return [Level(smoothed(picture, SMOOTHING[0] * size), 1.0)]

    def coarse() -> list[Level]:
        return list(_coarse_levels(raw, size, n_levels=n_levels, local_mean=local_mean))

    return [level for part in side_by_side([fine, coarse]) for level in part]


def _coarse_levels(picture: Map, size: float, *, n_levels: int, local_mean: bool) -> Iterator[Level]:
    if local_mean and n_levels > 1:
        picture = divide_by_local_mean(picture, COARSE_LIGHT_REACH * size)
    already = 0.0
    for number in range(1, n_levels):
        scale = 0.5**number
        height, width = (length // 2 * 2 for length in picture.shape)
        picture = np.asarray(
            cv2.resize(picture[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA),
            np.float32,
        )
        picture = smoothed(picture, np.sqrt((SMOOTHING[number] * size) ** 2 - already**2) * scale)
        already = SMOOTHING[number] * size
        yield Level(picture, scale)


def divide_by_local_mean(picture: Map, reach: float) -> Map:
    """Divide a picture by its Gaussian local mean of standard deviation `reach` px."""
    return picture * (np.float32(MIDDLE_GREY) / (blurred(picture, reach) + np.float32(DARKEST)))


def smoothed(picture: Map, deviation: float) -> Map:
    """Blur by a narrow Gaussian."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), float(deviation)), np.float32)


def local_variance(picture: Map, reach: float) -> Map:
    """Return the variance about each pixel, of a Gaussian window of standard deviation `reach` px."""
    return blurred((picture - blurred(picture, reach)) ** 2, reach)


def blurred(picture: Map, deviation: float) -> Map:
    """Blur by a wide Gaussian, on a smaller picture."""
    factor = max(int(deviation / 3), 1)
    height, width = picture.shape
    small = cv2.resize(
        picture, (max(width // factor, 1), max(height // factor, 1)), interpolation=cv2.INTER_AREA
    )
    small = cv2.GaussianBlur(small, (0, 0), deviation / factor)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


NO_MAP: Map = np.zeros((0, 0), np.float32)

WORTH = 50_000  # texels from which on several threads are faster


@dataclass(frozen=True, eq=False)
class TexturedObject:
    """A morphable model with texels on its surface."""

    model: MorphableModel
    texels: SurfaceTexels

    @cached_property
    def _used(self) -> NDArray[np.int64]:
        """Vertices of groups with texels."""
        return np.unique(self.texels.groups).astype(np.int64)

    @cached_property
    def _bases(self) -> Map:
        """Bases of the used vertices `(n_used, 3, width)`, in the columns of a pose's change."""
        dimension = RIGID + self.model.n_bases
        bases = np.zeros((len(self._used), 3, -(-dimension // LANES) * LANES), np.float32)
        bases[:, :, RIGID:dimension] = np.moveaxis(self.model.bases[:, self._used], 0, 2)
        return bases

    @cached_property
    def used_texels(self) -> kernels.Texels:
        """Texels for compiled loops, with numbers among the used vertices."""
        groups = np.searchsorted(self._used, self.texels.groups).astype(np.uint32)
        texels = self.texels
        start = texels.first[:-1]
        return kernels.Texels(
            groups,
            texels.first,
            texels.counts.astype(np.int32),
            texels.weights[start],
            texels.offsets[start],
            texels.areas,
        )

    @cached_property
    def _pairs(self) -> kernels.Pairs:
        """Pairs of used vertices with common texels."""
        n = len(self._used)
        ends = self.used_texels.groups[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
        edges, number = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
        of_group = np.concatenate([self.used_texels.groups.T, n + number.reshape(-1, 3).T])
        every = np.arange(n)
        all_ends = np.concatenate([np.stack([every, every], axis=1), edges])
        return kernels.Pairs(all_ends.astype(np.uint32), of_group.astype(np.uint32))

    def rows(self, poses: Poses) -> tuple[Map, Map, Callable[[int, int], None]]:
        """Return empty positions `(n, n_used, 2)` px and rows `(n, n_used, 2, width)`, and their writer.

        The writer fills those of poses from one number to another. The width is the poses' dimension rounded
        up to whole vectors, filled with zeros.
        """
        n, width = len(poses), self._bases.shape[2]
        positions = np.empty((n, len(self._used), 2), np.float32)
        rows = np.zeros((n, len(self._used), 2, width), np.float32)
        single = [part.astype(np.float32) for part in poses.arrays]

        def write(a: int, b: int) -> None:
            kernels.vertex_rows(*(part[a:b] for part in single), self._bases, positions[a:b], rows[a:b])

        return positions, rows, write

    def positions(self, poses: Poses) -> Map:
        """Return image positions of the used vertices, `(n, n_used, 2)` px."""
        shapes = (poses.morphs @ self._flat_bases).reshape(len(poses), -1, 3)
        seen = shapes @ np.swapaxes(poses.rotations[:, :2], -1, -2) + poses.translations[:, None]
        return seen.astype(np.float32)

    @cached_property
    def _flat_bases(self) -> Array:
        return self.model.bases[:, self._used].reshape(self.model.n_bases, -1)

    def visible(self, poses: Poses) -> NDArray[np.bool_]:
        """Return whether texels face the viewer and are not occluded, `(n, n_texels)`."""
        if not len(self.model.triangles):
            return np.ones((len(poses), len(self.texels)), np.bool_)
        return visible(self.model.positions(poses), self.model.triangles, self.texels)

    def observe(
        self, levels: Sequence[Level], poses: Poses, visible: NDArray[np.bool_]
    ) -> tuple[Map, NDArray[np.bool_]]:
        """Sample texels on each level, `(n, n_levels, n_texels)`, and return which are in the picture.

        On coarse levels only the texels in use there are sampled for certain; others may be 0.
        """
        positions = self.positions(poses)
        margin = np.abs(self.texels.offsets).max(initial=0) + 2 ** len(levels)
        size = np.array(levels[0].image.shape[::-1])
        within = bool((positions > margin).all() and (positions < size - 1 - margin).all())
        values = np.zeros((len(poses), len(levels), len(self.texels)), np.float32)
        seen = np.empty(visible.shape, np.bool_)

        def work(a: int, b: int) -> None:
            area, here = np.empty(visible[a:b].shape, np.float32), visible[a:b]
            for number, level in enumerate(levels):
                kernels.sample_texels(
                    level, number, 4**number if within else 1, self.used_texels, visible[a:b],
                    positions[a:b], values[a:b], area,
                )  # fmt: skip
                if number == 0 or not within:
                    here = here & (area > 0)
            seen[a:b] = here

        over_bands(work, len(poses), worth=values.size > 3 * WORTH)
        return values, seen


@dataclass(frozen=True, eq=False)
class TextureLikelihood:
    """Likelihood of a picture, given the experts' predicted textures."""

    surface: TexturedObject
    levels: Sequence[Level]  # of the picture, fine to coarse
    mean: Map  # `(n_experts, n_levels, n_texels)` float32: predicted texture on each level
    temperature: Map  # `(n_experts, n_texels)` float32: V + sigma_w^2
    visible: NDArray[np.bool_]  # `(n_experts, n_texels)`, constant while poses change

    @cached_property
    def _textures(self) -> kernels.Textures:
        mean = np.ascontiguousarray(self.mean)
        return kernels.Textures(mean, np.reciprocal(self.temperature), np.log(self.temperature), self.visible)

    def equations(self, level: int, poses: Poses, owner: NDArray[np.int64]) -> "Equations":
        """Return the normal equations at `poses`, of which number m belongs to expert `owner[m]`."""
        positions, rows, write_rows = self.surface.rows(poses)
        n, width, dimension = len(poses), rows.shape[3], poses.dimension
        matrices, vectors = np.empty((n, width, width), np.float32), np.empty((n, width), np.float32)
        totals = np.empty((n, 3))

        def work(a: int, b: int) -> None:
            write_rows(a, b)
            kernels.normal_equations(
                self.levels[level], level, self.surface.used_texels, self.surface._pairs,
                self._textures, owner[a:b], positions[a:b], rows[a:b], dimension,
                kernels.NormalSums(matrices[a:b], vectors[a:b], totals[a:b]),
            )  # fmt: skip

        over_bands(work, n, worth=n * len(self.surface.texels) > WORTH * 4**level)
        return Equations(
            matrices[:, :dimension, :dimension].astype(np.float64),
            vectors[:, :dimension].astype(np.float64),
            totals,
            rows,
        )

    def sums(self, poses: Poses, owner: NDArray[np.int64], background: Map = NO_MAP, level: int = 0) -> Array:
        """Return sums over visible texels of a e^2 / tau, a log tau, a, and a times `background`, `(n, 4)`.

        `background` is a map of the size of the picture on `level`.
        """
        positions = self.surface.positions(poses)
        sums = np.empty((len(poses), 4))

        def work(a: int, b: int) -> None:
            kernels.texel_densities(
                self.levels[level], level, self.surface.used_texels, self._textures, owner[a:b],
                positions[a:b], background, sums[a:b],
            )  # fmt: skip

        over_bands(work, len(poses), worth=len(poses) * len(self.surface.texels) > WORTH * 4**level)
        return sums

    def misfit(self, poses: Poses, level: int, contrast: Map) -> Array:
        """Return the mean of e^2 / tau of the first expert's texture over that of the picture's `contrast` on
        the level, `(n,)`; infinite if none is visible. Alone, it would be least where there is nothing.
        """
        squares, _, areas, power = self.sums(poses, np.zeros(len(poses), np.int64), contrast, level).T
        return np.where(areas > 0, squares / np.maximum(power, 1e-9), np.inf)


@dataclass(frozen=True, eq=False)
class Equations:
    """Gauss-Newton's normal equations for poses."""

    # `(n, dimension, dimension)` and `(n, dimension)`: sums of a J'J / tau and a J'e / tau
    matrices: Array
    vectors: Array
    sums: Array  # `(n, 3)`: of a e^2 / tau, a log tau and a
    # `(n, n_used, 2, width)` float32: how vertices move with the pose; columns past its dimension are 0
    rows: Map
