"""Ghosts: blobs in whose place nothing stands, but the background's picture shows something that has gone."""

import math

import cv2
import numpy as np

from ...models.background.layers import Layer
from ...models.objects.kernels.blobs import Patch, outline_contrast
from .blob_scene import BlobScene
from .blobs import Blob, Map

OUTLINE_TIME = 0.1
"""s after which a comparison of outlines is worth a whole new one."""


def ghost_layer(blob: Blob) -> Layer:
    """There is no object where the blob is, nor right beside it."""
    top, left = blob.corner
    shape = cv2.dilate((blob.mask > 0.25).astype(np.float32), np.ones((5, 5), np.uint8))
    return Layer(top, left, np.asarray(shape, np.float32), None, ghost=True)


def ghost_evidence(blob: Blob, mask: Map, patch: Patch, scene: BlobScene) -> float:
    """Evidence that the outline is an edge of the remembered background instead of one of the image."""
    picture = scene.picture(*blob.corner, mask.shape)
    in_image, in_picture, length = outline_contrast(patch.planes, picture, patch.free, mask, 2)
    if length < 8:
        return blob.ghost_evidence
    worth = min(scene.elapsed / OUTLINE_TIME, 1.0)
    found = worth * (math.log((in_picture + 3) / (in_image + 3)) - 0.25)
    return max(blob.ghost_evidence + found, 0.0)
