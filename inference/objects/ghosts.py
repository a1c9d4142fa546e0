"""Ghosts: blobs in whose place nothing stands, but the background's picture shows something that has gone.

Of a blob two things may be true: something real stands there, or it is a ghost. With colours a right inside
of its outline and b right outside, in the image I and in the background's picture B,

    p(I, B | real)  = prod_k  u_I  f_B(a_B - b_B)
    p(I, B | ghost) = prod_k  f_I(a_I - b_I)  u_B

f: a contrast within the scene, log-logistic about its median, which is measured a little further outside, in
the image (with its noise) and in the picture; u: any contrast, as likely as the scene's own on average, so
that scenes without an edge speak for neither. Neighbours along an outline are not independent, so the log
ratio of both is tempered; nor are looks at the same outline: a blob that stays as it is has one such view.
As it travels, each of its own lengths brings another one, and speaks for itself: a ghost does not travel.
Only lengths count by which it has left the place where it appeared, since there it may have been taken for
one thing with its ghost. What was found on the way stays for the blob's life.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from ...models.background.layers import Layer
from ...models.objects.kernels.blobs import Patch, outline_contrasts
from .blob_geometry import overlap
from .blob_scene import BlobScene
from .blobs import MARGIN, Blob, Map

REACH = 2
"""px to either side of an outline, which is as exact as that."""

VIEW_TIME = 0.4
"""s over which a view is averaged: masks err for a while in the same way."""

TRAVELLED = -5.0
"""nats, log ratio of ghost and real for each own length that something travels."""

MOST_EVIDENCE = 20.0
"""nats, that all views together are worth, either way."""

LEAST_OUTLINE = 8
"""px of an outline, from which on it tells something."""


def ghost_layer(blob: Blob) -> Layer:
    """There is no object where the blob is, nor right beside it."""
    top, left = blob.corner
    shape = cv2.dilate((blob.mask > 0.25).astype(np.float32), np.ones((5, 5), np.uint8))
    return Layer(top, left, np.asarray(shape, np.float32), None, ghost=True)


def outline_evidence(patch: Patch, picture: Map, mask: Map) -> float:
    """Log ratio of ghost and real, nats, summed over an outline as if its pixels were independent.

    Parameters
    ----------
    patch
        of the image.
    picture
        `(channels, height, width)` planes of the background there.
    mask
        `(height, width)`.
    """
    image, remembered = np.empty((2, 2, 4 * mask.size), np.float32)
    count = outline_contrasts(patch.planes, patch.free, mask, REACH, image)
    if count < LEAST_OUTLINE:
        return 0.0
    outline_contrasts(picture, patch.free, mask, REACH, remembered)
    return _surprise(*remembered[:, :count]) - _surprise(*image[:, :count])


def _surprise(across: Map, beside: Map) -> float:
    """How much less likely contrasts across an outline are than those beside it, by the density of these."""
    scale = float(np.median(beside)) + 1
    return float(2 * np.log((scale + across) / (scale + beside)).sum(dtype=np.float64))


def weighed(blob: Blob, mask: Map, patch: Patch, scene: BlobScene, temper: float) -> tuple[float, float]:
    """Evidence of the present view and of those before, after a frame (nats, ghost over real).

    Parameters
    ----------
    blob
        before the frame, registered.
    mask
        after it.
    patch
        of the image, cut out where the blob is.
    scene
        the frame.
    temper
        how many independent observations one pixel is worth.
    """
    found = temper * outline_evidence(patch, scene.picture(*blob.corner, mask.shape), mask)
    view = blob.view + (found - blob.view) * -math.expm1(-scene.elapsed / VIEW_TIME)
    if overlap(blob.box, blob.origin):
        return view, blob.past_views
    lengths = scene.elapsed * math.hypot(*blob.velocity) / blob.length
    past = blob.past_views + lengths * (view + TRAVELLED)
    return view, min(max(past, -MOST_EVIDENCE), MOST_EVIDENCE)


def inherited(blob: Blob, others: Sequence[Blob]) -> float:
    """Evidence (nats) that a newborn has from what it touches: it is as likely as not a part of that."""
    x, y, width, height = blob.box
    reach = (x - MARGIN, y - MARGIN, width + 2 * MARGIN, height + 2 * MARGIN)
    return min((0.5 * other.past_views for other in others if overlap(reach, other.box)), default=0.0)
