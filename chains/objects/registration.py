"""Finding blobs again: where a frame shows each of them, front to back, and as which layers."""

from functools import partial

import cv2
import numpy as np

from ...models.numerics.threads import side_by_side, thread_count
from ...models.pixels.kernels.layers import LAYER, Pools
from ...models.pixels.layers import LayerSheet, log_density_ratio, log_uniform
from ...models.pixels.pixel_labels import PixelMessage
from .blob_table import Blobs
from .blobs import Map
from .kernels.records import Picture
from .kernels.registration import Matching, deal, register, scratch_for_search


def picture_of(pixels: PixelMessage) -> Picture:
    """A frame, with an image and a background, as loops over blobs need it."""
    assert pixels.image is not None
    assert pixels.background is not None
    assert pixels.subtraction is not None
    image = np.ascontiguousarray(pixels.image)
    image = image if image.ndim == 3 else image[:, :, None]
    odds = pixels.subtraction.smoothed.reshape(image.shape[:2])
    return Picture(image, odds, np.float32(pixels.background.prior))


def registered(blobs: Blobs, pixels: PixelMessage, outliers: float, temper: float, elapsed: float) -> Blobs:
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
    if not len(blobs):
        return blobs
    table, terms = blobs.table.copy(), Matching(log_uniform(blobs.channels), outliers, temper, elapsed)
    picture, room = picture_of(pixels), scratch_for_search(table, blobs.channels)
    lots, count = np.zeros(len(table), np.int64), min(thread_count(), len(table))
    if count > 1:
        deal(table, count, lots)

    def work(lot: int) -> None:
        register(table, blobs.pools, picture, terms, lots, lot, np.empty(room, np.float32))

    side_by_side([partial(work, lot) for lot in range(count)])
    return blobs.with_table(table)


def front_to_back(blobs: Blobs) -> Blobs:
    """What stands lower in the picture is nearer."""
    return blobs.taken(np.lexsort((blobs.table["identity"], -blobs.feet)))


def layers_of(blobs: Blobs, outliers: float, strength: float, ghost_evidence: float) -> LayerSheet:
    """Blobs, front to back, as layers; a ghost says that there is no object where it is, nor beside it."""
    known, table = blobs.table, np.empty(len(blobs), LAYER)
    table["top"], table["left"] = np.floor(known["position"] + 0.5).T
    for name in ("rows", "columns", "start", "coloured", "spread"):
        table[name] = known[name]
    table["log_ratio"] = log_density_ratio(blobs.channels, known["spread"])
    table["outliers"], table["strength"] = outliers, strength
    table["ghost"] = blobs.ghost_evidence >= ghost_evidence
    masks = blobs.masks
    for k in np.flatnonzero(table["ghost"]).tolist():
        shape = _around(blobs[k].mask)
        table["start"][k] = len(masks)
        masks = np.concatenate([masks, shape.reshape(-1)])
    return LayerSheet(table, Pools(masks, blobs.colours), blobs.channels)


def _around(mask: Map) -> Map:
    return np.asarray(cv2.dilate((mask > 0.25).astype(np.float32), np.ones((5, 5), np.uint8)), np.float32)
