"""Corners: places of a picture that can be told from all places about them (Shi and Tomasi 1994)."""

import cv2
import numpy as np
from numpy.typing import NDArray

from .alignment import align_patches, sample_patches

Numbers = NDArray[np.float64]

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
