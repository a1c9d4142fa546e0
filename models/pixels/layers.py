"""Layers of objects in front of the background: what they say of the pixels that they cover."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.checks import CountFrom0, NotNegative, Positive, Shape, between, checked
from ..core.short_repr import short_repr
from ..numerics.compiled import compiled, exponential, inlined, logarithm
from . import colour

_f4 = np.float32

LEAST_CLEAR = 1e-3  # what a mask leaves of a pixel at least, so that logarithms stay finite

_LEAST = _f4(1e-30)  # of a product of many layers; the logarithm wants normal numbers


LAYER = np.dtype(
    [
        *((name, np.int64) for name in ("top", "left", "rows", "columns", "start", "coloured", "ghost")),
        *((name, np.float64) for name in ("colour_variance", "log_ratio", "outliers", "strength")),
    ]
)
"""A layer as loops over pixels need it: see `models.pixels.layers.Layer`.

Its mask begins at `start` of those of all layers, its colours, if it is `coloured`, at `channels * start`;
with `log_ratio` the density of its own colour is relative to the uniform one.
"""


class Pools(NamedTuple):
    """Pixels of all layers, float32: `(n,)` of masks, and `(channels * n,)` of colours, plane by plane."""

    masks: NDArray[np.float32]
    colours: NDArray[np.float32]


class Composition(NamedTuple):
    """Layers composed in regions that are apart, as of `ComposedLayers`; elsewhere they say nothing."""

    regions: NDArray[np.int64]  # (n, 4): top, left, height, width px
    starts: NDArray[np.int64]  # (n,): where the pixels of each begin in the flat maps
    clear: NDArray[np.float32]
    explained: NDArray[np.float32]
    shift: NDArray[np.float32]


class Sprite(NamedTuple):
    """Mask `(height, width)` and colours `(channels, height, width)` of an object, all float32.

    A pixel that it covers shows its colour with the density, relative to the uniform one, exp(log_ratio -
    half_precision d^2) in a share 1 - outliers of all cases; without channels every colour is alike.
    """

    mask: NDArray[np.float32]
    appearance: NDArray[np.float32]
    half_precision: np.float32
    log_ratio: np.float32
    outliers: np.float32


@compiled
def apart(layers, size, frames, members):
    """Group layers that overlap, or whose common frame overlaps others; frames are apart.

    Writes the frames' top, left, bottom, right px inside of a picture of `size` into `frames` `(n, 4)`, and
    into `members` `(n,)` in which frame each layer is, -1 where it is none in the picture. Gives how many
    there are.
    """
    count = 0
    for k in range(layers.size):
        layer = layers[k]
        top, left, bottom, right = layer.top, layer.left, layer.top + layer.rows, layer.left + layer.columns
        members[k] = -1
        if top >= size[0] or left >= size[1] or bottom <= 0 or right <= 0:
            continue
        own = count
        members[k], count = own, count + 1
        other = 0
        while other < own:
            its_top, its_left, its_bottom, its_right = frames[other]
            if top < its_bottom and its_top < bottom and left < its_right and its_left < right:
                top, left = min(top, its_top), min(left, its_left)
                bottom, right = max(bottom, its_bottom), max(right, its_right)
                # the last frame but this one takes the place of the one that was swallowed
                frames[other] = frames[own - 1]
                for j in range(k + 1):
                    if members[j] == other or members[j] == own:
                        members[j] = own - 1
                    elif members[j] == own - 1:
                        members[j] = other
                own, count, other = own - 1, count - 1, 0
            else:
                other += 1
        frames[own, 0], frames[own, 1], frames[own, 2], frames[own, 3] = top, left, bottom, right
    for k in range(count):
        frames[k, 0], frames[k, 1] = max(frames[k, 0], 0), max(frames[k, 1], 0)
        frames[k, 2], frames[k, 3] = min(frames[k, 2], size[0]), min(frames[k, 3], size[1])
    return count


@inlined
def _squared_distance(pixels, k, own, j, plane, channels):
    """Of the colour of pixel `k` of a picture from colour `j` of an appearance, whose planes are apart."""
    if channels == 1:
        d0 = _f4(pixels[k]) - own[j]
        return d0 * d0
    one, two = np.uint64(1), np.uint64(2)
    luma, red, blue = colour.planes_of(pixels[k], pixels[k + one], pixels[k + two])
    d0, d1, d2 = luma - own[j], red - own[j + plane], blue - own[j + two * plane]
    return d0 * d0 + d1 * d1 + d2 * d2


@compiled
def compose(layers, pools, members, image, regions, starts, clear, explained, distance):
    """Compose layers front to back in their regions, in their order.

    `regions`, `starts` are those of `Composition`, `members` is the region of each layer. Without an `image`
    `(height, width, channels)`, which has no pixels then, any colour is as likely: densities
    integrate to 1. `distance` has room for the longest row of a layer.
    """
    _, width, channels = image.shape
    pixels, masks, colours = image.reshape(-1), pools.masks, pools.colours
    for k in range(layers.size):
        if members[k] < 0:
            continue
        layer, start = layers[k], starts[members[k]]
        top, left, rows, columns = regions[members[k]]
        compared = layer.coloured and channels > 0
        half_precision = _f4(0.5 / layer.colour_variance)
        log_ratio = _f4(layer.log_ratio) if compared else _f4(0)
        outliers, strength = _f4(layer.outliers), _f4(layer.strength)
        inlying = _f4(1) - outliers
        first, end = max(left - layer.left, 0), min(layer.columns, left + columns - layer.left)
        count, plane = np.uint64(end - first), np.uint64(layer.rows * layer.columns)
        away = distance[: end - first]
        for row in range(max(top - layer.top, 0), min(layer.rows, top + rows - layer.top)):
            here = layer.start + row * layer.columns + first
            covers = masks[here : here + end - first]
            there = start + (layer.top + row - top) * columns + layer.left + first - left
            free, weight = clear[there : there + end - first], explained[there : there + end - first]
            if layer.ghost:
                for x in range(count):
                    weight[x] *= _f4(1.0) - _f4(0.998) * covers[x] * free[x]
                continue
            if compared:
                shown = np.uint64(channels * ((layer.top + row) * width + layer.left + first))
                own = np.uint64(channels * layer.start + row * layer.columns + first)
                if channels == 3:
                    for x in range(count):
                        seen = shown + np.uint64(3) * x
                        away[x] = _squared_distance(pixels, seen, colours, own + x, plane, 3)
                else:
                    for x in range(count):
                        away[x] = _squared_distance(pixels, shown + x, colours, own + x, plane, 1)
            else:
                away[:] = _f4(0)
            for x in range(count):
                density = inlying * exponential(log_ratio - half_precision * away[x]) + outliers
                weight[x] += strength * free[x] * covers[x] * density
                free[x] *= max(_f4(1.0) - covers[x], _f4(LEAST_CLEAR))


@compiled
def shift_of(clear, explained, shift):
    """Write the log ratio of what layers say for background and for objects, `(n,)` each."""
    for i in range(clear.size):
        shift[i] = logarithm(max(clear[i], _LEAST)) - logarithm(max(explained[i], _LEAST))


Map = NDArray[np.float32]
Region = tuple[int, int, CountFrom0, CountFrom0]
"""Top, left, height, width px of a part of the picture, which may reach over its edges."""

HIGHEST = 1 + 1e-6  # of a mask's values: a probability with the rounding of float32


@short_repr
@checked
@dataclass(frozen=True, eq=False)
class Layer:
    """Prediction of one object for the pixels in its region: probability of cover, and colour.

    Parameters
    ----------
    top, left
        px, of the region; it may extend beyond the image.
    mask
        `(height, width)` float32, probability that the object covers the pixel.
    appearance
        `(channels, height, width)` float32 in the planes of `colour`; `None` for any colour.
    colour_variance, outliers
        squared grey levels, variance of the object's colour about its appearance; and share of pixels whose
        colour is not as remembered.
    strength
        prior odds of this object over an unknown one in front of the background.
    ghost
        instead: the message that there is no object at the mask.
    """

    top: int
    left: int
    mask: Annotated[Map, Shape("height", "width")]
    appearance: Annotated[Map, Shape("channels", "height", "width")] | None
    colour_variance: Positive = 300.0
    outliers: Annotated[float, between(0, 1)] = 0.1
    strength: NotNegative = 10.0
    ghost: bool = False

    def __post_init__(self) -> None:
        lowest, highest = self.mask.min(initial=0.0), self.mask.max(initial=0.0)
        if lowest < 0 or highest > HIGHEST:
            raise ValueError(
                f"mask: got values from {lowest} to {highest}, expected probabilities from 0 to 1"
            )

    @property
    def log_ratio(self) -> float:
        """Log of N(I; I, colour_variance) over the uniform density of colours."""
        if self.appearance is None:
            return 0.0
        return float(log_density_ratio(len(self.appearance), self.colour_variance))


def log_uniform(channels: int) -> float:
    """Return minus the log of the uniform density of colours, in their planes."""
    return float(np.log(colour.VOLUME[channels]) + channels * np.log(256.0))


def log_density_ratio(channels: int, colour_variance: ArrayLike) -> NDArray[np.float64]:
    """Return log N(I; I, variance) over the uniform density of colours, shaped as `colour_variance`."""
    normaliser = 0.5 * channels * np.log(2 * np.pi * np.asarray(colour_variance))
    return np.asarray(log_uniform(channels) - normaliser)


@short_repr
@dataclass(frozen=True, eq=False)
class ComposedLayers:
    """Layers that overlap, composed: what they say together inside the region that holds them."""

    top: int  # px, inside the picture
    left: int
    clear: Map  # (height, width): weight of B=1, the chance that no layer covers the pixel
    explained: Map  # weight of B=0 with this pixel's colour, relative to "anything" alone
    shift: Map  # log of clear over explained

    @property
    def region(self) -> Region:
        """Top, left, height, width px."""
        return self.top, self.left, self.clear.shape[0], self.clear.shape[1]

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns in the picture."""
        height, width = self.clear.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)


class LayerSheet(NamedTuple):
    """Table of one chain's layers, front to back: `(n,)` records of type `LAYER`, and their pixels."""

    table: NDArray[np.void]
    pools: Pools
    channels: int

    @classmethod
    def of(cls, layers: Sequence[Layer]) -> Self:
        """Return the table of single layers.

        Raises
        ------
        TypeError
            if they are no layers.
        """
        if not (isinstance(layers, Sequence) and all(isinstance(layer, Layer) for layer in layers)):
            raise TypeError(f"layers: got {layers!r}, expected a list of Layer(...)")
        channels = max(
            (0 if layer.appearance is None else len(layer.appearance) for layer in layers), default=0
        )
        table = np.zeros(len(layers), LAYER)
        ends = np.cumsum([0, *(layer.mask.size for layer in layers)])
        masks, colours = np.empty(ends[-1], np.float32), np.empty(channels * ends[-1], np.float32)
        for layer, record, start, end in zip(layers, table, ends.tolist(), ends[1:].tolist(), strict=False):
            masks[start:end] = layer.mask.reshape(-1)
            if layer.appearance is not None:
                colours[channels * start : channels * end] = layer.appearance.reshape(-1)
            for name in ("top", "left", "colour_variance", "log_ratio", "outliers", "strength", "ghost"):
                record[name] = getattr(layer, name)
            record["rows"], record["columns"] = layer.mask.shape
            record["start"], record["coloured"] = start, layer.appearance is not None
        return cls(table, Pools(masks, colours), channels)


@short_repr
class LayerStack:
    """Layers front to back, and their composition.

    A product of stacks contains the layers of several chains: the layers of each chain are composed, and the
    results are multiplied, in any order.

    Parameters
    ----------
    layers
        of each chain, front to back.

    Raises
    ------
    TypeError
        if they are no sequences of layers.
    """

    def __init__(self, *layers: Sequence[Layer] | LayerSheet) -> None:
        sheets = (factor if isinstance(factor, LayerSheet) else LayerSheet.of(factor) for factor in layers)
        self.factors = tuple(sheet for sheet in sheets if len(sheet.table))
        self._composed: dict[tuple[int, tuple[int, int]], tuple[Any, Composition]] = {}
        self._regions: dict[tuple[int, tuple[int, int]], tuple[ComposedLayers, ...]] = {}

    def __len__(self) -> int:
        return sum(len(sheet.table) for sheet in self.factors)

    def __mul__(self, other: "LayerStack") -> "LayerStack":
        if not self.factors or not other.factors:
            return self if self.factors else other
        return LayerStack(*self.factors, *other.factors)

    def composition(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> Composition:
        """Return the layers composed in disjoint regions of an image of `size` `(height, width)`."""
        if not self.factors:
            return NOTHING  # and nothing is remembered: the stack without layers lives as long as the program
        key = (id(image), size)
        if key not in self._composed:
            self._composed[key] = (image, self._compose(image, size))
        return self._composed[key][1]

    def composed(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> tuple[ComposedLayers, ...]:
        """Return the composed layers as maps of two dimensions."""
        composed, key = self.composition(image, size), (id(image), size)
        if key not in self._regions and self.factors:
            self._regions[key] = tuple(_regions(composed))
        return self._regions.get(key, ())

    def cover(self, size: tuple[int, int]) -> NDArray[np.float32]:
        """Return `(height, width)` float32: probability that a pixel is covered, whatever it shows."""
        covered = np.zeros(size, np.float32)
        for region in self.composed(None, size):
            covered[region.window] = 1 - region.clear
        return covered

    def _compose(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> Composition:
        tables = [sheet.table for sheet in self.factors]
        table = tables[0] if len(tables) == 1 else np.concatenate(tables)
        frames, members = np.empty((len(table), 4), np.int64), np.empty(len(table), np.int64)
        regions = frames[: apart(table, size, frames, members)]
        regions[:, 2:] -= regions[:, :2]
        ends = np.cumsum(regions[:, 2] * regions[:, 3])
        starts, total = ends - regions[:, 2] * regions[:, 3], int(ends[-1]) if len(ends) else 0
        maps = np.empty((3, total), np.float32)
        maps[:2] = 1
        pixels = np.zeros((0, 0, 0), np.uint8) if image is None else np.ascontiguousarray(image)
        pixels = pixels if pixels.ndim == 3 else pixels[:, :, None]
        row = np.empty(table["columns"].max(initial=0), np.float32)
        first = 0
        for sheet in self.factors:
            end, into = first + len(sheet.table), np.ones((2, total), np.float32)
            compose(sheet.table, sheet.pools, members[first:end], pixels, regions, starts, *into, row)
            maps[:2] *= into
            first = end
        shift_of(*maps)
        return Composition(regions, starts, *maps)


NO_LAYERS = LayerStack()

NOTHING = Composition(np.zeros((0, 4), np.int64), np.zeros(0, np.int64), *np.zeros((3, 0), np.float32))
"""What no layers say."""


def _regions(composed: Composition) -> Iterator[ComposedLayers]:
    for (top, left, rows, columns), start in zip(
        composed.regions.tolist(), composed.starts.tolist(), strict=True
    ):
        pixels = slice(start, start + rows * columns)
        maps = (values[pixels].reshape(rows, columns) for values in composed[2:])
        yield ComposedLayers(top, left, *maps)
