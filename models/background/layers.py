"""Layers of objects in front of the background: what they say of the pixels that they cover."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from . import colour
from .kernels.layers import Sprite, compose_layer, shift_of

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
    def box(self) -> PixelBox:
        """Top, left, bottom, right (exclusive) px."""
        height, width = self.mask.shape
        return self.top, self.left, self.top + height, self.left + width

    @property
    def log_density_ratio(self) -> float:
        """Log of N(I; I, spread) over the uniform density of colours."""
        return 0.0 if self.appearance is None else log_density_ratio(self.appearance.shape[0], self.spread)


def log_density_ratio(channels: int, spread: float) -> float:
    """Log of N(I; I, spread) over the uniform density of colours."""
    density = -0.5 * channels * np.log(2 * np.pi * spread) + np.log(colour.VOLUME[channels])
    return float(density + channels * np.log(256.0))


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
        for factor in layers:
            if not (isinstance(factor, Sequence) and all(isinstance(layer, Layer) for layer in factor)):
                raise TypeError(f"layers: got {factor!r}, expected a list of Layer(...)")
        self.factors = tuple(tuple(factor) for factor in layers if factor)
        self._regions: dict[tuple[int, tuple[int, int]], tuple[Any, tuple[Region, ...]]] = {}

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

    def regions(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> tuple[Region, ...]:
        """The layers, composed, in boxes that are apart; `size` of the picture is `(height, width)`."""
        if not len(self):
            return ()  # and nothing is remembered: the stack without layers lives as long as the program
        key = (id(image), size)
        if key not in self._regions:
            self._regions[key] = (image, tuple(self._compose(image, size)))
        return self._regions[key][1]

    def _compose(self, image: NDArray[np.uint8] | None, size: tuple[int, int]) -> Iterator[Region]:
        numbered = [(layer, k) for k, factor in enumerate(self.factors) for layer in factor]
        placed = [(layer, k) for layer, k in numbered if _inside(layer, size)]
        for box, members in _apart([layer.box for layer, _ in placed]):
            top, left = max(box[0], 0), max(box[1], 0)
            region = empty_region(top, left, min(box[2], size[0]) - top, min(box[3], size[1]) - left)
            patch = None if image is None else colour.patch(image, *region.box)
            group = [placed[k] for k in members]
            for factor in dict.fromkeys(factor for _, factor in group):
                part = region if factor == group[0][1] else empty_region(*region.box)
                for layer, its_factor in group:
                    if its_factor == factor:
                        add_layer(part, layer, patch)
                if part is not region:
                    np.multiply(region.clear, part.clear, out=region.clear)
                    np.multiply(region.explained, part.explained, out=region.explained)
            shift_of(region.clear, region.explained, region.shift)
            yield region


NO_LAYERS = LayerStack()


def empty_region(top: int, left: int, height: int, width: int) -> Region:
    """A region in which no layer has spoken yet."""
    maps = np.ones((3, height, width), np.float32)
    return Region(top, left, maps[0], maps[1], maps[2])


def add_layer(region: Region, layer: Layer, patch: Map | None) -> None:
    """Put a layer behind those that the region holds already.

    `patch` `(channels, height, width)` are the image's planes in the region, `None` if there is no image.
    """
    appearance, log_ratio = layer.appearance, layer.log_density_ratio
    if patch is None or appearance is None:  # any colour: densities integrate to 1
        appearance, log_ratio = np.zeros((0, *layer.mask.shape), np.float32), 0.0
        patch = np.zeros((0, *region.clear.shape), np.float32)
    numbers = (np.float32(value) for value in (0.5 / layer.spread, log_ratio, layer.outliers))
    compose_layer(
        region.clear, region.explained, patch, layer.top - region.top, layer.left - region.left,
        Sprite(layer.mask, appearance, *numbers), np.float32(layer.strength), layer.ghost,
    )  # fmt: skip


def _inside(layer: Layer, size: tuple[int, int]) -> bool:
    top, left, bottom, right = layer.box
    return top < size[0] and left < size[1] and bottom > 0 and right > 0


def _apart(boxes: Sequence[PixelBox]) -> list[tuple[PixelBox, list[int]]]:
    """Boxes that overlap, or whose common frame overlaps others, in one frame; frames do not overlap.

    Gives every frame (top, left, bottom, right) with the numbers of the boxes in it, in order.
    """
    groups: list[tuple[PixelBox, list[int]]] = []
    for k, frame in enumerate(boxes):
        members = [k]
        while True:
            touched = next((group for group in groups if _overlap(group[0], frame)), None)
            if touched is None:
                break
            groups.remove(touched)
            other, its_members = touched
            first, last = np.minimum(frame[:2], other[:2]).tolist(), np.maximum(frame[2:], other[2:]).tolist()
            frame = (*first, *last)
            members += its_members
        groups.append((frame, sorted(members)))
    return groups


def _overlap(a: PixelBox, b: PixelBox) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
