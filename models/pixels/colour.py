"""The colour space in which pixels are compared: luma, and chroma twice as heavy.

Shadows and light move luma; clothes differ in chroma. Camera noise is about as large in the doubled chroma
planes as in luma, so one variance serves all three.
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numerics.compiled import compiled, inlined

_f4 = np.float32

FROM_BGR: NDArray[np.float64] = np.array(
    [[0.114, 0.587, 0.299], [-0.1625640, -0.8370620, 0.9996260], [0.9994080, -0.6621360, -0.3372720]]
)
"""Rows: luma, 2 Cr, 2 Cb (ITU-R BT.601) of a BGR pixel."""

VOLUME = {0: 1.0, 1: 1.0, 3: float(abs(np.linalg.det(FROM_BGR)))}
"""By number of channels: how much a volume of grey levels grows in the planes."""


@inlined
def planes_of(blue, green, red):
    """Return luma, 2 Cr and 2 Cb, float32, of a pixel's channels."""
    b, g, r = _f4(blue), _f4(green), _f4(red)
    luma = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
    return luma, _f4(1.426) * (r - luma), _f4(1.128) * (b - luma)


@inlined
def colour_gap(pixels, others, i, channels):
    """Return the squared distance in the planes of pixel `i` of two pictures, whose channels are in a row."""
    k = channels * i
    if channels == 1:
        d0 = _f4(pixels[k]) - _f4(others[k])
        return d0 * d0
    b = _f4(pixels[k]) - _f4(others[k])
    g = _f4(pixels[k + 1]) - _f4(others[k + 1])
    r = _f4(pixels[k + 2]) - _f4(others[k + 2])
    d0, d1, d2 = planes_of(b, g, r)
    return d0 * d0 + d1 * d1 + d2 * d2


@compiled
def _planes_of_colour(pixels, out):
    for i in range(out.shape[1]):
        luma, red, blue = planes_of(pixels[3 * i], pixels[3 * i + 1], pixels[3 * i + 2])
        out[0, i], out[1, i], out[2, i] = luma, red, blue


@lru_cache
def from_pixels(channels: int) -> NDArray[np.float32]:
    """Return the matrix `(channels, channels)` float32 that takes a pixel's channels to its planes."""
    return FROM_BGR.astype(np.float32) if channels == 3 else np.ones((1, 1), np.float32)


@lru_cache
def to_pixels(channels: int) -> NDArray[np.float32]:
    """Return the inverse of `from_pixels`."""
    return np.linalg.inv(from_pixels(channels))


def to_planes(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the planes `(channels, height * width)` float32 of a grey or BGR image."""
    if image.ndim == 2:
        return image.reshape(1, -1).astype(np.float32)
    planes = np.empty((3, image.shape[0] * image.shape[1]), np.float32)
    _planes_of_colour(np.ascontiguousarray(image).reshape(-1), planes)
    return planes


def to_image(planes: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the uint8 image of `size = (height, width)`, grey or BGR, whose planes these are."""
    values = to_pixels(planes.shape[0]) @ planes.astype(np.float32, copy=False)
    np.clip(np.rint(values, out=values), 0, 255, out=values)
    channels = values.astype(np.uint8).reshape(-1, *size)
    if len(channels) == 1:
        return np.asarray(channels[0], np.uint8)
    return np.asarray(cv2.merge(list(channels)), np.uint8)
