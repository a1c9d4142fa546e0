"""Where small patches of a grey picture are in another one: normalised correlation, all points in one call.

The evidence of RSMCM §4.3 about single points: a patch is sought where its point is expected, and the peak of
the correlation says where it is and how surely.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .kernels import patches as patch_kernels

Numbers = NDArray[np.float64]

DEVIATIONS = 3.0
"""Of the prior, that a window reaches to each side."""

RIM = 2
"""px that it reaches further: its middle is a whole pixel, and on its rim there are no peaks."""


@dataclass(frozen=True, eq=False)
class PatchMatches:
    """Best places of patches in a picture.

    Parameters
    ----------
    score
        `(n,)` normalised correlation at the best place, -1 where there is none.
    rival
        `(n,)` normalised correlation at the second-best one, more than half a patch away; -1 where there is
        none. When it is near `score` it is not clear which of both is the point.
    position
        `(n, 2)` px, between pixels; where there is no place, what was expected.
    information
        `(n, 2, 2)` 1/px^2, inverse of the position's covariance; zeros where there is no place, and without
        full rank where a patch has an edge only.
    """

    score: Numbers
    rival: Numbers
    position: Numbers
    information: Numbers


def reaches_of(covariance: ArrayLike, most: int) -> NDArray[np.int64]:
    """Half sizes of the windows in which a prior has its mass.

    Parameters
    ----------
    covariance
        `(n, 2, 2)` px^2.
    most
        px, the largest half size.

    Returns
    -------
    reaches
        `(n, 2)` px, along x and y.
    """
    variances = np.diagonal(np.asarray(covariance, np.float64), axis1=1, axis2=2)
    wanted = np.minimum(DEVIATIONS * np.sqrt(variances), most)
    return np.minimum(np.ceil(wanted).astype(np.int64) + RIM, most)


def sample_patches(
    image: NDArray[np.uint8], positions: ArrayLike, side: int = 5, unit: bool = False
) -> NDArray[np.float32]:
    """Patches about positions between pixels, interpolated linearly.

    Parameters
    ----------
    image
        `(height, width)` uint8.
    positions
        `(n, 2)` px, of their middles.
    side
        px, odd.
    unit
        with mean 0 and length 1, as `search_patches` wants them; zeros for a patch without contrast.

    Returns
    -------
    patches
        `(n, side, side)` float32, rows first; zeros where a patch is not wholly in the picture.

    Raises
    ------
    ValueError
        if the image is not grey, `side` is even or below 3, or a position is not finite.
    """
    _check_image(image, side)
    places = _checked_positions(positions)
    patches = np.empty((len(places), side * side), np.float32)
    patch_kernels.sample(np.ascontiguousarray(image), places, side, unit, patches)
    return patches.reshape(-1, side, side)


def search_patches(
    image: NDArray[np.uint8], patches: NDArray[np.float32], expected: ArrayLike, reaches: ArrayLike
) -> PatchMatches:
    """Best places of patches in windows about where they are expected.

    The whole windows are searched pixel by pixel. From the best pixel that is no rim's, least squares of the
    normalised patches lead to the place between pixels; their residuals and gradients give the covariance.
    A prior over positions stays out of it: it is multiplied in by who knows it.

    Parameters
    ----------
    image
        `(height, width)` uint8.
    patches
        `(n, side, side)` float32, mean 0 and length 1 (`sample_patches` with `unit`); zeros are found
        nowhere.
    expected
        `(n, 2)` px, middles of the windows, of which whole pixels are taken; they may lie outside the
        picture.
    reaches
        half sizes of the windows along x and y, px, `(n, 2)` or one for all. Only places where a patch is
        wholly in the picture count.

    Returns
    -------
    matches
        of the `n` patches.

    Raises
    ------
    ValueError
        if the image is not grey, a position is not finite, or the shapes do not fit.
    """
    given = np.asarray(patches, np.float32)
    if given.ndim != 3 or given.shape[1] != given.shape[2]:
        raise ValueError(f"patches: got {given.shape}, expected (n, side, side)")
    n_points, side = given.shape[:2]
    _check_image(image, side)
    places = _checked_positions(expected)
    windows = np.asarray(reaches, np.int64)
    if len(places) != n_points or windows.shape not in ((), (n_points, 2)):
        raise ValueError(
            f"expected, reaches: got {places.shape} and {windows.shape} for {n_points} patches, "
            f"expected ({n_points}, 2) and ({n_points}, 2) or one number"
        )
    size = np.array([image.shape[1], image.shape[0]])
    windows = np.clip(np.broadcast_to(windows, (n_points, 2)), 0, size)
    # far outside is as good as a little further than a window reaches
    middles = np.rint(np.clip(places, -side - windows, size + side + windows)).astype(np.int64)
    templates = np.zeros((n_points, patch_kernels.padded(side * side, patch_kernels.TAPS)), np.float32)
    templates[:, : side * side] = given.reshape(n_points, side * side)
    found = PatchMatches(np.empty(n_points), np.empty(n_points), places.copy(), np.empty((n_points, 2, 2)))
    patch_kernels.search(
        np.ascontiguousarray(image),
        templates,
        side,
        middles,
        windows,
        found.score,
        found.rival,
        found.position,
        found.information,
    )
    return found


def _check_image(image: NDArray[np.uint8], side: int) -> None:
    if image.dtype != np.uint8 or image.ndim != 2:
        raise ValueError(f"image: got {image.shape} {image.dtype}, expected (height, width) uint8")
    if side < 3 or side % 2 == 0:
        raise ValueError(f"side: got {side} px, expected an odd number from 3")


def _checked_positions(positions: ArrayLike) -> Numbers:
    places = np.ascontiguousarray(positions, np.float64)
    if places.ndim != 2 or places.shape[1] != 2 or not np.isfinite(places).all():
        raise ValueError(f"positions: got {places.shape}, expected (n, 2) finite numbers")
    return places
