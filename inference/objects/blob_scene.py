"""A frame as blobs need it: patches of its pixels, what layers explain, and what other chains expect."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from ...models.background.layers import LayerStack
from ...models.background.pixel_labels import PixelMessage
from ...models.objects.box_detector import HEIGHT, WIDTH
from ...models.objects.box_message import BoxMessage
from ...models.objects.kernels.blobs import UNKNOWN_COLOUR, Patch, count_foreground, gather
from ...models.objects.kernels.masks import clear_blocks
from .blob_geometry import THINNEST, cover_by, paste
from .blobs import MARGIN, Blob, Map, Pair


def cut_out(
    pixels: PixelMessage, top: int, left: int, shape: tuple[int, int], in_front: Sequence[Blob]
) -> Patch:
    """What the image and the background say of the pixels in a box, and what no blob in front covers."""
    assert pixels.image is not None
    assert pixels.subtraction is not None
    image = pixels.image if pixels.image.ndim == 3 else pixels.image[:, :, None]
    patch = Patch(
        np.empty((image.shape[2], *shape), np.float32),
        np.empty(shape, np.float32),
        np.empty(shape, np.float32),
    )
    gather(image, pixels.subtraction.smoothed.reshape(image.shape[:2]), top, left, patch)
    cover_by(patch.free, top, left, in_front)
    return patch


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
        self._expected: dict[int, tuple[Pair, Pair]] = {}
        if boxes is not None:
            sides = [HEIGHT, WIDTH]
            for identity, mean, covariance in zip(*boxes.objects.moments, strict=True):
                self._expected[int(identity)] = (mean[sides], covariance.diagonal()[sides])
        self._regions = layers.regions(pixels.image, self.size)

    def expected_size(self, blob: Blob) -> Pair:
        """Usual height and width px of a blob, and what other chains expect of it, by their precisions."""
        if blob.identity not in self._expected:
            return blob.size
        expected, variance = self._expected[blob.identity]
        own, others = 1 / (0.15 * blob.size) ** 2, 1 / np.maximum(variance, 1.0)
        size: Pair = (own * blob.size + others * expected) / (own + others)
        return np.maximum(size, 0.5 * blob.size)

    def explained(self, top: int, left: int, shape: tuple[int, int]) -> Map:
        """What all layers together explain of the pixels in a box, 1 where there is none."""
        out = np.ones(shape, np.float32)
        for region in self._regions:
            paste(out, top, left, region.explained, region.top, region.left)
        return out

    def picture(self, top: int, left: int, shape: tuple[int, int]) -> Map:
        """Planes of the remembered background in a box."""
        background = self.pixels.background
        assert background is not None
        window = (slice(max(top, 0), max(top + shape[0], 0)), slice(max(left, 0), max(left + shape[1], 0)))
        planes = background.planes(window)
        out = np.zeros((len(planes), *shape), np.float32)
        paste(out, top, left, planes, max(top, 0), max(left, 0))
        return out

    def entered(self, blob: Blob) -> Map | None:
        """1 where a blob's patch has come into the picture since the last frame; `None` if nowhere."""
        before = blob.changed(position=blob.position - self.elapsed * blob.velocity)
        if self.inside(before) == self.inside(blob):
            return None
        out = np.zeros(blob.mask.shape, np.float32)
        out[self.inside(blob)] = 1
        out[self.inside(before)] = 0
        return out

    def coloured(self, blob: Blob) -> Blob:
        """A blob that was just born of a detection, with the colours that the image shows where it is."""
        planes = cut_out(self.pixels, *blob.corner, blob.mask.shape, []).planes
        return blob.changed(appearance=np.where(blob.mask > 0.2, planes, np.float32(UNKNOWN_COLOUR)))

    def inside(self, blob: Blob) -> tuple[slice, slice]:
        """The part of a blob's patch that lies in the picture."""
        (top, left), (rows, columns) = blob.corner, blob.mask.shape
        return (
            slice(min(max(0, -top), rows), max(0, min(rows, self.size[0] - top))),
            slice(min(max(0, -left), columns), max(0, min(columns, self.size[1] - left))),
        )

    def unexplained(self, blobs: Sequence[Blob], smallest: float) -> Iterator[tuple[Pair, Map, Map]]:
        """Foreground spots of `smallest` px or more that do not touch a blob, with room around them.

        Gives top and left, the mask, and the planes of the pixels.
        """
        for top, left, bottom, right, area in self._spots(blobs):
            if area < max(smallest, THINNEST * max(bottom - top, right - left) ** 2):
                continue
            top, left = top - MARGIN, left - MARGIN
            patch = cut_out(self.pixels, top, left, (bottom + MARGIN - top, right + MARGIN - left), blobs)
            mask = np.minimum(0.9, patch.free / (1 + np.exp(patch.log_odds))).astype(np.float32)
            if float(mask.sum()) >= smallest:
                yield np.array([float(top), float(left)]), mask, patch.planes

    def _spots(self, blobs: Sequence[Blob]) -> Iterator[tuple[int, int, int, int, int]]:
        """Top, left, bottom, right and area px of foreground, block by block."""
        height, width = self.size
        scale = max(1, round(max(height, width) / 192))
        assert self.pixels.subtraction is not None
        counts = np.empty((-(-height // scale), -(-width // scale)), np.int32)
        count_foreground(self.pixels.subtraction.smoothed, width, scale, counts)
        for blob in blobs:
            clear_blocks(counts, *blob.corner, blob.mask, scale)
        spots = (counts * 4 >= scale * scale).astype(np.uint8)
        found, labels, boxes, _ = cv2.connectedComponentsWithStats(spots, connectivity=8)
        for label in range(1, found):
            x, y, columns, rows, _ = (int(value) for value in boxes[label])
            area = int(counts[labels == label].sum())
            yield scale * y, scale * x, scale * (y + rows), scale * (x + columns), area
