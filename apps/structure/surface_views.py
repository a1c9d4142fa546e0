"""A reconstruction as a picture: one frame, laid over the points that are seen in it, and turned."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from ...inference.sfm.affine_camera import scaled_rotations
from ...models.core.frame import Frame
from .reconstruction import Numbers, Reconstruction

Image = NDArray[np.uint8]

PAPER = 255
LONGEST_EDGE = 0.2
"""Of triangles, as a share of the picture's diagonal: longer ones span what belongs to nothing."""
LEAST_SURE = 4.0
"""Deviation, in medians over the points, beyond which a point is left out."""


def surface_views(frames: Sequence[Frame], found: Reconstruction, angles: Sequence[float]) -> list[Image]:
    """Show the frame with most points from other sides.

    Its points are joined by triangles that carry its picture; what lies nearer is drawn over what lies
    farther away.

    Parameters
    ----------
    frames
        with images in some.
    found
        Euclidean.
    angles
        degrees by which the object is turned about the picture's vertical axis.

    Returns
    -------
    list
        a picture `(height, width, 3)` BGR for each angle; none if no frame has an image with 3 points.
    """
    with_image = [index for index, frame in enumerate(frames) if frame.image is not None]
    counts = np.count_nonzero(found.observed[with_image], axis=1)
    if not len(counts) or counts.max() < 3:
        return []
    index = with_image[int(counts.argmax())]
    image = frames[index].image
    assert image is not None
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    sure = found.deviations <= LEAST_SURE * np.median(found.deviations)
    points = np.flatnonzero(found.observed[index] & sure)
    if len(points) < 3:
        return []
    scales, rotations = scaled_rotations(found.cameras[index : index + 1, :, :3])
    space = scales[0] * found.shape[points] @ rotations[0].T  # px: right, down, away
    places = found.places[index, points]
    triangles = _triangles(places, LONGEST_EDGE * float(np.hypot(*picture.shape[:2])))
    return [_turned(np.asarray(picture, np.uint8), places, space, triangles, angle) for angle in angles]


def _triangles(places: Numbers, longest: float) -> NDArray[np.int64]:
    """Indices `(n, 3)` of the Delaunay triangles without an edge that is too long."""
    corners = Delaunay(places).simplices.astype(np.int64)
    edges = places[corners] - places[np.roll(corners, 1, axis=1)]
    kept: NDArray[np.int64] = corners[np.linalg.norm(edges, axis=2).max(axis=1) <= longest]
    return kept


def _turned(
    picture: Image, places: Numbers, space: Numbers, triangles: NDArray[np.int64], angle: float
) -> Image:
    height, width = picture.shape[:2]
    middle = np.median(space, axis=0)
    right, down = np.median(places, axis=0)
    x, y, away = (space - middle).T
    cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turned = np.stack([cosine * x - sine * away + right, y + down], axis=1)
    depth = sine * x + cosine * away
    sheet: NDArray[Any] = np.full((height, width, 3), PAPER, np.uint8)
    for corners in triangles[np.argsort(-depth[triangles].mean(axis=1))]:
        _lay(sheet, picture, places[corners], turned[corners])
    return np.asarray(sheet, np.uint8)


def _lay(sheet: NDArray[Any], picture: Image, source: Numbers, target: Numbers) -> None:
    """Copy a triangle of the picture to another one of the sheet."""
    height, width = sheet.shape[:2]
    left, top = np.maximum(np.floor(target.min(axis=0)), 0).astype(int)
    right, bottom = np.minimum(np.ceil(target.max(axis=0)) + 1, (width, height)).astype(int)
    if right <= left or bottom <= top:
        return
    corners = (target - (left, top)).astype(np.float32)
    warp = cv2.getAffineTransform(source.astype(np.float32), corners)
    size = (int(right - left), int(bottom - top))
    part = cv2.warpAffine(picture, warp, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask = np.zeros((size[1], size[0]), np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 1)
    cv2.copyTo(part, mask, sheet[top:bottom, left:right])
