"""Where exactly a patch is in a picture: to fractions of a pixel, and how surely.

A peak of the normalised correlation of 5x5 pixels is a fifth of a pixel off, for any change of brightness and
contrast is free, and at a corner that is much like a motion. Here both may change a little only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kernels import alignment as alignment_kernels
from .kernels.alignment import Expected, Light

Numbers = NDArray[np.float64]

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
