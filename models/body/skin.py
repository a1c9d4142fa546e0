"""Colour of a person's skin, learned from the face (none is built in), and static skin-coloured regions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..core.checks import Shape
from ..core.short_repr import short_repr
from .kernels import look_up_colours

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Map = NDArray[np.float32]

BINS = (8, 64, 64)  # of luma and two differences of colour: shades of one skin differ mostly in luma

N_BINS = int(np.prod(BINS))

SMOOTHING = (0.7, 1.5, 1.5)  # of the histograms, bins: one face has too few pixels for 32,768 of them
FLOOR = 1 / 30  # added to both densities, in units of the uniform one: unseen colours have ratio 1
HIGHEST = 4.0  # nats: bound of the log ratio
LEAST_COLOUR = 4.0  # levels by which one pixel in a hundred differs from grey; compression causes 1 to 3

FACE_CENTRE, FACE_AXES = 0.52, (0.33, 0.42)
"""In a detector's box: skin without the background beside the chin, and mostly without hair."""

HEAD_AXES = (0.8, 0.95)  # about the box's centre: beyond it there is neither face nor neck
BLUR = 0.8  # px: against noise of single pixels


@short_repr
@dataclass(frozen=True, eq=False)
class SkinColour:
    """Log ratio of colours in the face against elsewhere."""

    # nats, from -4 to 4, by Y, Cr, Cb: log of a colour's density in faces over others
    table: Annotated[NDArray[np.float32], Shape(8, 64, 64)]

    @classmethod
    def learned(cls, images: Sequence[Image], boxes: Array) -> Self | None:
        """Learn from images in which the person's face was found.

        The rest of the image includes the hands: where they cover a share s of it, the ratio stays below
        1 / s, which the bound of the table hides unless s is above 2 %.

        `images`: n of them, `(height, width, 3)` uint8 BGR, or `(height, width)`; `boxes` `(n, 4)` px: x, y,
        width, height of one face in each. Returns `None` if the images have no colour. Raises `ValueError`
        if there are no images, or not as many boxes.
        """
        if not len(images) or np.shape(boxes) != (len(images), 4):
            raise ValueError(
                f"boxes: got {np.shape(boxes)} for {len(images)} images, expected one face in each: (n, 4)"
            )
        coloured = [(image, box) for image, box in zip(images, boxes, strict=True) if has_colour(image)]
        if not coloured:
            return None
        face, rest = np.zeros(N_BINS), np.zeros(N_BINS)
        for image, box in coloured:
            inside, outside = _regions(image.shape[:2], box)
            face += count_colours(image, inside)
            rest += count_colours(image, outside)
        return cls(log_count_ratio(face, rest))

    def log_odds(self, image: Image) -> NDArray[np.float32]:
        """Return the log odds of skin, of even prior: `(height, width)` float32 nats, from -4 to 4.

        `image` `(height, width, 3)` uint8 BGR. Raises `ValueError` if it has one channel.
        """
        return self.log_odds_of(smoothed(image))

    def log_odds_of(self, colours: Image) -> NDArray[np.float32]:
        """Return the log odds of skin of a `smoothed` image."""
        return look_up(self.table, colours)


def count_colours(image: Image, where: NDArray[np.bool_]) -> Array:
    """Count colours of an image `where` `(height, width)`, by bins."""
    return np.asarray(np.bincount(_bins(smoothed(image))[where], minlength=N_BINS), np.float64)


def log_count_ratio(some: Array, others: Array) -> NDArray[np.float32]:
    """Return the log ratio of two densities of colours from counts, a table of nats over `BINS`."""
    ratio = np.log(_density(some) / _density(others))
    return np.asarray(np.clip(ratio, -HIGHEST, HIGHEST), np.float32)


def look_up(table: NDArray[np.float32], colours: Image) -> NDArray[np.float32]:
    """`(height, width)` nats: values of a table over `BINS` at the colours of a `smoothed` image."""
    out = np.empty(colours.shape[:2], np.float32)
    look_up_colours(colours.reshape(-1, 3), table.reshape(-1), out.reshape(-1))
    return out


def face_ellipses(boxes: Array) -> Array:
    """`(k, 4)` px: centres and half axes of the skin in a detector's boxes `(k, 4)`: x, y, width, height."""
    return np.hstack([boxes[:, :2] + boxes[:, 2:] * (0.5, FACE_CENTRE), boxes[:, 2:] * FACE_AXES])


def has_colour(image: Image) -> bool:
    """Whether an image differs from a grey one by more than compression causes."""
    if image.ndim == 2:
        return False
    some = image[::4, ::4].astype(np.int16)
    return bool(np.percentile(np.ptp(some, axis=2), 99) > LEAST_COLOUR)


def smoothed(image: Image) -> Image:
    """Return the smoothed Y, Cr, Cb `(height, width, 3)` of a BGR image, for tables of colours.

    Raises `ValueError` if the image has one channel.
    """
    if image.ndim != 3:
        raise ValueError(f"image: got {image.shape}, expected (height, width, 3)")
    return np.asarray(cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), BLUR), cv2.COLOR_BGR2YCrCb), np.uint8)


def _bins(picture: Image) -> NDArray[np.int64]:
    luma, red, blue = np.moveaxis(picture.astype(np.int64), 2, 0)
    bins: NDArray[np.int64] = (luma >> 5 << 12) | (red >> 2 << 6) | (blue >> 2)
    return bins


def _density(counts: Array) -> Array:
    """Density relative to the uniform one, `BINS`."""
    smooth = gaussian_filter(counts.reshape(BINS), SMOOTHING)
    return np.asarray(smooth * (smooth.size / max(smooth.sum(), 1.0)) + FLOOR)


def _regions(shape: tuple[int, ...], box: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Pixels in the face, and those outside of the head."""
    x, y, width, height = box
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    across = (columns - x - width / 2) / width
    face = np.hypot(across / FACE_AXES[0], (rows - y - FACE_CENTRE * height) / (FACE_AXES[1] * height)) < 1
    head = np.hypot(across / HEAD_AXES[0], (rows - y - height / 2) / (HEAD_AXES[1] * height)) < 1
    return face, ~head


AWAY = 0.2  # quantile of a pixel's log odds over a clip that counts as static
LEAST_FRAMES = 8  # frames, spread over a clip, that this needs
LEVELS = 16  # steps of the log odds per nat: 8 bits of memory a pixel


def static_skin(colour: SkinColour, images: Sequence[NDArray[np.uint8]]) -> Map | None:
    """Return the log odds of skin that a pixel has in nearly all frames, `(height, width)` nats, 0 at least.

    They are subtracted from the log odds in a frame, as evidence of hands.

    `images`: of one clip with a camera at rest, spread over its length; `None` of fewer than `LEAST_FRAMES`.
    Raises `ValueError` if they are of different sizes.
    """
    if len(images) < LEAST_FRAMES:
        return None
    sizes = {image.shape for image in images}
    if len(sizes) > 1:
        raise ValueError(f"images: got {len(sizes)} different sizes, expected one")
    odds = np.stack([np.rint(LEVELS * colour.log_odds(image)).astype(np.int8) for image in images])
    rank = int(AWAY * len(images))
    odds.partition(rank, axis=0)
    return np.asarray(np.maximum(odds[rank], 0) / LEVELS, np.float32)
