"""Small square pieces of a grey picture: what points look like, where exactly they are, and corners.

A peak of the normalised correlation of 5x5 pixels is a fifth of a pixel off, for any change of brightness and
contrast is free, and at a corner that is much like a motion. `align_patches` lets both change a little only.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.short_repr import short_repr
from .kernels import alignment as alignment_kernels
from .kernels.alignment import Expected, Light

Numbers = NDArray[np.float64]
Pixels = NDArray[np.float32]


@short_repr
@dataclass(frozen=True, eq=False)
class Patches:
    """What points look like.

    Parameters
    ----------
    identities
        `(n,)` int64, increasing.
    pixels
        `(n, side, side)` float32: grey values about each point, rows first.
    """

    identities: NDArray[np.int64]
    pixels: Pixels

    def __len__(self) -> int:
        return len(self.identities)


def ncc(one: Pixels, other: Pixels) -> Numbers:
    """Normalised correlation, `(n,)` from -1 to 1, of patches `(n, side, side)`; 0 where one is of one
    colour."""
    a, b = _centred(one), _centred(other)
    lengths = np.sqrt(np.square(a).sum(axis=(1, 2)) * np.square(b).sum(axis=(1, 2)))
    correlation: Numbers = (a * b).sum(axis=(1, 2)) / np.where(lengths > 0, lengths, 1.0)
    return correlation


def with_light_of(patches: Pixels, others: Pixels) -> Pixels:
    """Patches `(n, side, side)` with the brightness and contrast that `others` of the same things have."""
    a, b = _centred(patches), _centred(others)
    squares = np.square(a).sum(axis=(1, 2), keepdims=True)
    gain = (a * b).sum(axis=(1, 2), keepdims=True) / np.where(squares > 0, squares, 1.0)
    level = others.mean(axis=(1, 2), keepdims=True, dtype=np.float64)
    lit: Pixels = (level + np.maximum(gain, 0.0) * a).astype(np.float32)
    return lit


def _centred(patches: Pixels) -> Numbers:
    centred: Numbers = np.subtract(patches, patches.mean(axis=(1, 2), keepdims=True, dtype=np.float64))
    return centred


PIXEL_NOISE = 2.0
"""Grey values, standard deviation of the noise of a pixel."""

LIGHTER, STRONGER, WARPED = 3.0, 0.07, 0.05
"""Standard deviations of how a patch changes from one picture to another: grey values by which it is lighter,
share by which its contrast is higher, and radians of rotation, shares of scale and stretch. The last ones
hardly blur a position, but else a patch that turns away slides along its edges."""

SMOOTHED = 1.5
"""Variance of residuals over what remains of it when one of both pictures is interpolated."""

ROUNDING = 0.5
"""Squared grey values by which residuals are off however well a patch fits."""


LIGHT = Light((PIXEL_NOISE / np.array([LIGHTER, STRONGER, *[WARPED] * 4])) ** 2, SMOOTHED, ROUNDING)
"""All of that, as the loops have it."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Patches where they fit the picture best.

    Parameters
    ----------
    position
        `(n, 2)` px.
    covariance
        `(n, 2, 2)` px^2: of the errors that noise as large as the residuals makes.
    ncc
        `(n,)` normalised correlation there, -1 where nothing near fits.
    """

    position: Numbers
    covariance: Numbers
    ncc: Numbers


def align_patches(
    grey: NDArray[np.uint8],
    patches: NDArray[np.float32],
    start: Numbers,
    farthest: float,
    expected: Expected | None = None,
) -> Aligned:
    """Move patches by Gauss-Newton steps to where the picture is like them.

    What is expected of their places holds those that an edge lets slide. It is no part of the covariances.

    Parameters
    ----------
    grey
        `(height, width)`.
    patches
        `(n, side, side)` grey values.
    start
        `(n, 2)` px, within a pixel of where they are.
    farthest
        px from there, along either axis, where they can be at most.
    expected
        of their places; nothing if not given.
    """
    position = np.array(start, np.float64)
    expected = expected or Expected(position.copy(), np.zeros((len(position), 2, 2)))
    covariance, ncc = np.empty((len(position), 2, 2)), np.empty(len(position))
    which = np.arange(len(position))
    alignment_kernels.align_all(grey, patches, which, position, expected, LIGHT, farthest, covariance, ncc)
    return Aligned(position, covariance, ncc)


def sample_patches(grey: NDArray[np.uint8], positions: Numbers, side: int) -> NDArray[np.float32]:
    """Grey values `(n, side, side)` about `positions`, `(n, 2)` px, by cubic interpolation."""
    patches = np.empty((len(positions), side, side), np.float32)
    places = np.ascontiguousarray(positions, np.float64)
    alignment_kernels.sample_all(grey, places, np.arange(len(places)), patches)
    return patches


QUALITY = 0.01
"""Least smaller eigenvalue of the gradients' moments, as a share of the best corner's."""

CLEAR = 0.25
"""px, standard deviation to which a corner's patch must fix its place, when pixels are as noisy as usual."""

NOISE = 4.0
"""Noise of pixels over what remains where a patch is compared with itself: a guess on the safe side."""

BORDER = 6
"""px from the picture's edge, within which nothing begins."""


def find_corners(
    grey: NDArray[np.uint8], most: int, away_from: Numbers, spacing: float, side: int
) -> Numbers:
    """Corners, the best first.

    Parameters
    ----------
    grey
        `(height, width)`.
    most
        how many at most.
    away_from
        `(n, 2)` px, places that are taken.
    spacing
        px, least distance to these and to each other.
    side
        px, of the patches that must fix the place.

    Returns
    -------
    `(m, 2)` px; none in a picture of one colour.
    """
    mask = np.zeros(grey.shape, np.uint8)
    mask[BORDER:-BORDER, BORDER:-BORDER] = 255
    for x, y in np.rint(away_from).astype(int).tolist():
        cv2.circle(mask, (x, y), int(spacing), 0, -1)
    found = cv2.goodFeaturesToTrack(grey, most, QUALITY, spacing, mask=mask, blockSize=side)
    if found is None:
        return np.zeros((0, 2))
    corners = found.reshape(-1, 2).astype(np.float64)
    itself = align_patches(grey, sample_patches(grey, corners, side), corners, 1.0)
    deviation = NOISE * np.sqrt(np.linalg.eigvalsh(itself.covariance)[:, 1])
    clear: Numbers = corners[deviation < CLEAR]
    return clear
