"""A frame as blobs need it: where it shows them, what it teaches them, and what nobody explains."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.numerics.threads import side_by_side, thread_count
from ...models.objects.box_message import HEIGHT, WIDTH, BoxMessage
from ...models.pixels.kernels import LAYER, Pools
from ...models.pixels.layers import LayerSheet, LayerStack, log_density_ratio, log_uniform
from ...models.pixels.pixel_labels import PixelMessage
from .blobs import Blob, Blobs, Map, Pair
from .kernels.blobs import MARGIN, Patch, Picture, colour_newborn, cover_by, find_spots, gather
from .kernels.learning import THINNEST, Learning, Scene, fit, learn_all, scratch_for_learning
from .kernels.registration import Matching, deal, register, scratch_for_search

Spot = list[int]
"""Top, left, bottom, right px."""

BLOCKS = 192
"""Along the longer side of a picture, in which spots are looked for."""

MOST_SPOTS = 256
"""In one frame."""

VIEW_TIME = 0.4
"""s over which a view is averaged: masks err for a while in the same way."""


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


class BlobScene:
    """A frame in which blobs are updated.

    Parameters
    ----------
    pixels
        the image and the background's message.
    layers
        of all blobs.
    boxes
        what other chains say of the boxes of objects; `None` if there are none.
    elapsed
        s since the last frame with an image.
    """

    def __init__(
        self, pixels: PixelMessage, layers: LayerStack, boxes: BoxMessage | None, elapsed: float
    ) -> None:
        self.pixels = pixels
        self.size = pixels.size
        self.elapsed = elapsed
        self.newcomers = None if boxes is None else boxes.newcomers
        self.picture = picture_of(pixels)
        self._layers = layers
        self._objects = None if boxes is None else boxes.objects

    def expected_sizes(self, blobs: Blobs) -> Pair:
        """`(n, 2)` px, usual height and width, and what other chains expect of them, by their precisions."""
        sizes: Pair = np.ascontiguousarray(blobs.table["size"])
        if self._objects is None or not len(self._objects.identities) or not len(blobs):
            return sizes
        identities, means, covariances = self._objects.moments
        order = np.argsort(identities)
        place = order[
            np.searchsorted(identities, blobs.table["identity"], sorter=order).clip(max=len(order) - 1)
        ]
        known = identities[place] == blobs.table["identity"]
        sides = [HEIGHT, WIDTH]
        expected, variance = means[place][:, sides], covariances[place][:, sides, sides]
        own, others = 1 / (0.15 * sizes) ** 2, 1 / np.maximum(variance, 1.0)
        both = (own * sizes + others * expected) / (own + others)
        return np.where(known[:, None], np.maximum(both, 0.5 * sizes), sizes)

    def learned(self, blobs: Blobs, rule: Learning) -> tuple[Blobs, NDArray[np.bool_]]:
        """Blobs, given front to back, after the frame, and which of them live on."""
        before, table = blobs.table, blobs.table.copy()
        total, channels = fit(table, rule.ghost_evidence), blobs.channels
        masks, colours = np.empty(total, np.float32), np.empty(channels * total, np.float32)
        alive = np.empty(len(table), np.uint8)
        after = replace(blobs.with_table(table), masks=masks, colours=colours)
        composed = self._layers.composition(self.pixels.image, self.size)
        background = self.pixels.background
        assert background is not None
        scene = Scene(
            background.colours,
            composed.boxes,
            composed.starts,
            composed.explained,
            self.expected_sizes(blobs),
        )
        room, count = scratch_for_learning(table, channels), min(thread_count(), len(table))

        def work(first: int) -> None:
            which, scratch = np.arange(first, len(table), count), np.empty(room, np.float32)
            learn_all(
                which, before, blobs.pools, table, after.pools, self.picture, scene, rule, alive, scratch
            )

        if count:
            side_by_side([partial(work, first) for first in range(count)])
        return after, alive.astype(bool)

    def colour(self, blobs: Blobs, first: int) -> None:
        """Give blobs from the `first` on, which were just born, the colours that the image shows there."""
        for record in blobs.table[first:]:
            colour_newborn(record, blobs.pools, self.picture.image)

    def shown_in(self, spot: Spot, blobs: Blobs) -> tuple[Pair, Map, Map]:
        """Foreground in a spot with room around it that no blob covers: top and left, mask, and planes."""
        top, left = spot[0] - MARGIN, spot[1] - MARGIN
        shape = (spot[2] + MARGIN - top, spot[3] + MARGIN - left)
        planes = np.empty((blobs.channels, *shape), np.float32)
        odds, free = np.empty((2, *shape), np.float32)
        gather(self.picture.image, self.picture.log_odds, top, left, Patch(planes, odds, free))
        cover_by(free, top, left, blobs.table, blobs.pools)
        mask = np.minimum(0.9, free / (1 + np.exp(odds))).astype(np.float32)
        return np.array([float(top), float(left)]), mask, planes

    def spots(self, blobs: Blobs, smallest: float) -> list[Spot]:
        """Foreground of `smallest` px or more that does not touch a blob: top, left, bottom, right px."""
        height, width = self.size
        scale = max(1, round(max(height, width) / BLOCKS))
        counts = np.empty((-(-height // scale), -(-width // scale)), np.int32)
        memory = np.empty(max(height * width // 64 + 1 + width, counts.size), np.int64)
        found = np.empty((MOST_SPOTS, 5), np.int64)
        count = find_spots(
            self.picture.log_odds.reshape(-1), self.size, scale, blobs.table, blobs.pools, smallest, THINNEST,
            counts, memory, found,
        )  # fmt: skip
        spots: list[Spot] = found[:count, :4].tolist()
        return spots


def inherited(blob: Blob, others: Blobs) -> float:
    """Evidence (nats) that a newborn has from what it touches: it is as likely as not a part of that."""
    x, y, width, height = blob.box
    left, top, columns, rows = others.boxes.T
    touched = (x - MARGIN < left + columns) & (left < x + width + MARGIN)
    touched &= (y - MARGIN < top + rows) & (top < y + height + MARGIN)
    return float(np.min(0.5 * others.table["past_views"][touched], initial=0.0)) if touched.any() else 0.0
