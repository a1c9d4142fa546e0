"""Finding blobs again: where a frame shows each of them, front to back."""

import math
from collections.abc import Sequence

import numpy as np

from ...models.background.pixel_labels import PixelMessage
from ...models.objects.kernels.blobs import Expected, density_without, search
from .blob_geometry import FRESH
from .blob_scene import cut_out
from .blobs import Blob

ASTRAY, ASTRAY_TIME = 0.05, 0.1
"""Lengths, and s for which, a mask is off the object that a detector finds."""


def registered(
    blobs: Sequence[Blob], pixels: PixelMessage, outliers: float, temper: float, elapsed: float
) -> list[Blob]:
    """Blobs with place and velocity updated by the pixels that nothing in front covers.

    Parameters
    ----------
    blobs
        predicted, front to back.
    pixels
        with an image and a background.
    outliers
        share of a blob's pixels that look otherwise.
    temper
        how many independent observations one pixel is worth.
    elapsed
        s since the last frame.
    """
    placed: list[Blob] = []
    for blob in blobs:
        if blob.detected is not None and (blob.confidence < 0.5 or blob.seen < FRESH):
            placed.append(blob)  # its mask shows nothing that could be found again
            continue
        placed.append(_placed(blob, placed, pixels, outliers, temper, elapsed))
    return placed


def front_to_back(blobs: Sequence[Blob]) -> list[Blob]:
    """What stands lower in the picture is nearer."""
    return sorted(blobs, key=lambda blob: (-blob.foot, blob.identity))


def _placed(
    blob: Blob,
    in_front: Sequence[Blob],
    pixels: PixelMessage,
    outliers: float,
    temper: float,
    elapsed: float,
) -> Blob:
    """A blob after the Kalman update with the place where its mask and colours fit best."""
    top, left = blob.corner
    (place, both), (_, speed) = blob.covariance.tolist()
    reach = int(min(max(2.5 * math.sqrt(place) + 1, 2), max(6, min(0.35 * blob.length, 24))))
    rows, columns = blob.mask.shape
    patch = cut_out(pixels, top - reach, left - reach, (rows + 2 * reach, columns + 2 * reach), in_front)
    assert pixels.background is not None
    expected = Expected(blob.position[0] - top, blob.position[1] - left, 1 / max(place, 0.25))
    down, right, variance_y, variance_x = search(
        reach, expected, np.float32(temper), max(1, blob.mask.size // 1500), patch,
        density_without(patch.log_odds, np.float32(pixels.background.prior)), blob.sprite(outliers),
    )  # fmt: skip
    variance = min(max(variance_y, variance_x, 0.25), 100.0)
    if blob.detected is not None:
        # a mask errs with its box, and for a while: detections know better
        variance = max(variance, (ASTRAY * blob.length) ** 2 * max(ASTRAY_TIME / max(elapsed, 1e-3), 1.0))
    gain, speed_gain = place / (place + variance), both / (place + variance)
    innovation = np.array([top + down, left + right]) - blob.position
    after = [[(1 - gain) * place, (1 - gain) * both], [(1 - gain) * both, speed - speed_gain * both]]
    return blob.changed(
        position=blob.position + gain * innovation,
        velocity=blob.velocity + speed_gain * innovation,
        covariance=np.array(after),
    )
