"""Layers of objects in front of the background: what they say of the pixels that they cover."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.short_repr import short_repr
from . import colour
from .kernels import LAYER, Composition, Pools, apart, compose, shift_of

Map = NDArray[np.float32]
PixelBox = tuple[int, int, int, int]

HIGHEST = 1 + 1e-6
"""Of a mask's values: a probability with the rounding of float32."""


@short_repr
@dataclass(frozen=True, eq=False)
class Layer:
    """What one object says of the pixels in its box: that it covers them, and with what colour.

    Parameters
    ----------
    top, left
        px, of the box; it may reach over the picture's edge.
    mask
        `(height, width)` float32, probability that the object covers the pixel.
    appearance
        `(channels, height, width)` float32 in the planes of `colour`; `None` for any colour.
    spread
        squared grey levels: variance of the object's colour about its appearance.
    outliers
        share of pixels whose colour is not as remembered.
    strength
        how much likelier this object is to be seen in front of the background than something nobody knows.
    ghost
        instead: there is no object where the mask is, whatever the background remembers.
    """

    top: int
    left: int
    mask: Map
    appearance: Map | None
    spread: float = 300.0
    outliers: float = 0.1
    strength: float = 10.0
    ghost: bool = False

    def __post_init__(self) -> None:
        mask, appearance = self.mask, self.appearance
        if mask.ndim != 2 or (appearance is not None and appearance.shape[1:] != mask.shape):
            shapes = mask.shape if appearance is None else f"{mask.shape} and {appearance.shape}"
            raise ValueError(
                f"layer: got shapes {shapes}, expected a mask of (height, width) and an appearance of "
                "(channels, height, width)"
            )
        lowest, highest = mask.min(initial=0.0), mask.max(initial=0.0)
        if not (lowest >= 0 and highest <= HIGHEST):  # also where it is NaN
            raise ValueError(
                f"layer: got a mask from {lowest} to {highest}, expected probabilities from 0 to 1"
            )

    @property
    def log_ratio(self) -> float:
        """Log of N(I; I, spread) over the uniform density of colours."""
        return 0.0 if self.appearance is None else float(log_density_ratio(len(self.appearance), self.spread))


def log_uniform(channels: int) -> float:
    """Minus the log of the uniform density of colours, in their planes."""
    return float(np.log(colour.VOLUME[channels]) + channels * np.log(256.0))


def log_density_ratio(channels: int, spread: ArrayLike) -> NDArray[np.float64]:
    """Log of N(I; I, spread) over the uniform density of colours, in the shape of `spread`."""
    return np.asarray(log_uniform(channels) - 0.5 * channels * np.log(2 * np.pi * np.asarray(spread)))


@short_repr
@dataclass(frozen=True, eq=False)
class Region:
    """Layers that overlap, composed: what they say together inside the box that holds them.

    Parameters
    ----------
    top, left
        px, inside the picture.
    clear
        `(height, width)` float32: weight of B=1, the chance that no layer covers the pixel.
    explained
        `(height, width)` float32: weight of B=0 with this pixel's colour, relative to "anything" alone.
    shift
        log of clear over explained.
    """

    top: int
    left: int
    clear: Map
    explained: Map
    shift: Map

    @property
    def box(self) -> PixelBox:
        """Top, left, height, width px."""
        return self.top, self.left, self.clear.shape[0], self.clear.shape[1]

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns in the picture."""
        height, width = self.clear.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)


@short_repr
@dataclass(frozen=True, eq=False)
class LayerSheet(Sequence[Layer]):
    """Layers of one chain, front to back, with all their pixels in one array.

    Parameters
    ----------
    table
        `(n,)` records of type `LAYER`.
    pools
        their masks and colours.
    channels
        of the colours.
    """

    table: NDArray[np.void]
    pools: Pools
    channels: int

    @classmethod
    def of(cls, layers: Sequence[Layer]) -> Self:
        """The same of layers that are on their own.

        Raises
        ------
        TypeError
            if they are no layers.
        """
        if not (isinstance(layers, Sequence) and all(isinstance(layer, Layer) for layer in layers)):
            raise TypeError(f"layers: got {layers!r}, expected a list of Layer(...)")
        known = [0 if layer.appearance is None else len(layer.appearance) for layer in layers]
        channels = max(known, default=0)
        table = np.zeros(len(layers), LAYER)
        sizes = [layer.mask.size for layer in layers]
        starts = np.cumsum([0, *sizes])
        masks = np.empty(starts[-1], np.float32)
        colours = np.empty(channels * starts[-1], np.float32)
        for layer, record, start, size in zip(layers, table, starts.tolist(), sizes, strict=False):
            masks[start : start + size] = layer.mask.reshape(-1)
            if layer.appearance is not None:
                colours[channels * start : channels * (start + size)] = layer.appearance.reshape(-1)
            for name in ("top", "left", "spread", "log_ratio", "outliers", "strength", "ghost"):
                record[name] = getattr(layer, name)
            record["rows"], record["columns"] = layer.mask.shape
            record["start"], record["coloured"] = start, layer.appearance is not None
        return cls(table, Pools(masks, colours), channels)

    def __len__(self) -> int:
        return len(self.table)

    @overload
    def __getitem__(self, index: int, /) -> Layer: ...
    @overload
    def __getitem__(self, index: slice, /) -> Sequence[Layer]: ...
    def __getitem__(self, index: int | slice, /) -> Layer | Sequence[Layer]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        record = self.table[index]
        shape, start = (int(record["rows"]), int(record["columns"])), int(record["start"])
        end = start + shape[0] * shape[1]
        colours = self.pools.colours[self.channels * start : self.channels * end]
        return Layer(
            int(record["top"]),
            int(record["left"]),
            self.pools.masks[start:end].reshape(shape),
            colours.reshape(self.channels, *shape) if record["coloured"] else None,
            float(record["spread"]),
            float(record["outliers"]),
            float(record["strength"]),
            bool(record["ghost"]),
        )


@short_repr
class LayerStack:
    """Layers of one chain, front to back, and what they say together of an image.

    A product of stacks holds the layers of several chains: each chain's are composed for themselves, and what
    they say is multiplied, in whatever order. The same image is read only once.

    Parameters
    ----------
    layers
        of each chain, front to back.

    Raises
    ------
    TypeError
        if they are no sequences of layers.
    """

    def __init__(self, *layers: Sequence[Layer]) -> None:
        sheets = (factor if isinstance(factor, LayerSheet) else LayerSheet.of(factor) for factor in layers)
        self.factors = tuple(sheet for sheet in sheets if len(sheet))
        self._composed: dict[tuple[int, tuple[int, int]], tuple[Any, Composition]] = {}
        self._regions: dict[tuple[int, tuple[int, int]], tuple[Region, ...]] = {}

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All layers, those of each chain front to back."""
        return tuple(layer for factor in self.factors for layer in factor)

    def __len__(self) -> int:
        return sum(map(len, self.factors))

    def __mul__(self, other: "LayerStack") -> "LayerStack":
        if not self.factors or not other.factors:
            return self if self.factors else other
        return LayerStack(*self.factors, *other.factors)

    def composition(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> Composition:
        """The layers, composed, in boxes that are apart; `size` of the picture is `(height, width)`."""
        if not self.factors:
            return NOTHING  # and nothing is remembered: the stack without layers lives as long as the program
        key = (id(image), size)
        if key not in self._composed:
            self._composed[key] = (image, self._compose(image, size))
        return self._composed[key][1]

    def regions(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> tuple[Region, ...]:
        """The same as maps of two dimensions."""
        composed, key = self.composition(image, size), (id(image), size)
        if key not in self._regions and self.factors:
            self._regions[key] = tuple(_regions(composed))
        return self._regions.get(key, ())

    def _compose(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> Composition:
        tables = [sheet.table for sheet in self.factors]
        table = tables[0] if len(tables) == 1 else np.concatenate(tables)
        frames, members = np.empty((len(table), 4), np.int64), np.empty(len(table), np.int64)
        boxes = frames[: apart(table, size, frames, members)]
        boxes[:, 2:] -= boxes[:, :2]
        ends = np.cumsum(boxes[:, 2] * boxes[:, 3])
        starts, total = ends - boxes[:, 2] * boxes[:, 3], int(ends[-1]) if len(ends) else 0
        maps = np.empty((3, total), np.float32)
        maps[:2] = 1
        clear, explained, shift = maps
        pixels = np.zeros((0, 0, 0), np.uint8) if image is None else np.ascontiguousarray(image)
        pixels = pixels if pixels.ndim == 3 else pixels[:, :, None]
        row = np.empty(table["columns"].max(initial=0), np.float32)
        first = 0
        for sheet in self.factors:
            its_members = members[first : first + len(sheet)]
            into = (clear, explained) if first == 0 else np.ones((2, total), np.float32)
            compose(sheet.table, sheet.pools, its_members, pixels, boxes, starts, *into, row)
            if first > 0:
                clear *= into[0]
                explained *= into[1]
            first += len(sheet)
        shift_of(clear, explained, shift)
        return Composition(boxes, starts, clear, explained, shift)


NO_LAYERS = LayerStack()

NOTHING = Composition(np.zeros((0, 4), np.int64), np.zeros(0, np.int64), *np.zeros((3, 0), np.float32))
"""What no layers say."""


def _regions(composed: Composition) -> Iterator[Region]:
    for (top, left, rows, columns), start in zip(
        composed.boxes.tolist(), composed.starts.tolist(), strict=True
    ):
        pixels = slice(start, start + rows * columns)
        maps = (values[pixels].reshape(rows, columns) for values in composed[2:])
        yield Region(top, left, *maps)
