"""What objects leave behind: places that still show an object's colours although it has moved on.

A bag at its owner's feet is a part of his mask, which loses it where it hardly differs from the ground. Of
each pixel that an object has covered, the colour L_t is compared with A, which it has shown since, and with
E, which it showed before any object came:

    log p(L_t | stays) / p(L_t | left) = (|L_t - E|^2 - |L_t - A|^2) / (2 NOISE)

As A is known, a difference from E is seen that is too small to tell any colour from the ground. Parts that
stay for longer than a foot stands in a step, and that no mask holds any more, are layers of their own until
they show another colour. Where no object is, E follows the image; where A stays, A does. E is known once
it has been shown for as long, and longer than other colours since, so that it is no earlier object's.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Shape
from ...models.core.short_repr import short_repr
from ...models.numerics.compiled import compiled
from ...models.pixels.background import SPAN
from ...models.pixels.colour import colour_gap, to_planes
from ...models.pixels.layers import NO_LAYERS, Layer, LayerStack
from .blob_records import THINNEST, corner_of, cover_by

if TYPE_CHECKING:
    from .blobs import Blobs

_f4 = np.float32

NOISE = 30.0  # squared grey levels, of a colour about the one that it stays
SURPRISE = 9.2  # squared distance over the noise that one in a hundred exceeds
LEAST_RATIO = 0.5  # nats of a pixel, from which on it stays rather than that the object has left
STAYS = 1.0  # s; a foot stands for .6 s in a step
SURE = 2 * STAYS  # s for which E has been shown at most: another colour is the scene after as long
SAME = 7  # grey levels: no difference of as much in each channel is a surprise
BEGUN = 1e-3  # s, of what an object has just brought
PATIENCE = 0.2  # s for which what stays may look otherwise
BARE = 0.9  # probability that no mask holds a pixel, from which on it shows the scene
SCENE_TIME, OWN_TIME = 1.0, 0.2  # s, time constants of E and A, which move by a grey level a frame at least
COVER, COLOUR_VARIANCE, OUTLIERS = 0.9, 60.0, 0.1  # of the layers


@short_repr
@dataclass(frozen=True, eq=False)
class LeftBehind:
    """Colours that objects have brought to the places of a picture."""

    # A; nothing before any object
    shown: Annotated[NDArray[np.uint8], Shape("height", "width", "channels")]
    before: Annotated[NDArray[np.uint8], Shape("height", "width", "channels")]  # E
    # s for which it has shown A; below 0: for which it has shown E, without any object so far
    time: Annotated[NDArray[np.float32], Shape("height", "width")]
    parts: Annotated[NDArray[np.bool_], Shape("height", "width")]  # that objects have left behind

    @classmethod
    def nothing(cls, image: NDArray[np.uint8]) -> Self:
        """Return what is known when a scene begins with an image `(height, width[, channels])`."""
        first = image.copy().reshape(*image.shape[:2], -1)
        return cls(first, first, np.zeros(first.shape[:2], np.float32), np.zeros(first.shape[:2], np.bool_))

    def after(
        self,
        image: NDArray[np.uint8],
        blobs: "Blobs",
        are_sure: NDArray[np.bool_],
        ghosts: "Blobs",
        least_area: float,
        elapsed: float,
    ) -> Self:
        """Return what is known after an image `(height, width, channels)`, `elapsed` s after the last.

        Of the `blobs`, those that `are_sure` `(n,)` may leave something behind; where there are `ghosts`,
        nothing has been. Parts have `least_area` px or more, and are no lines.
        """
        shown, before, time = self.shown.copy(), self.before.copy(), self.time.copy()
        all_free, free = np.ones((2, *time.shape), np.float32)
        cover_by(all_free, 0, 0, blobs.table, blobs.pools)
        sure = blobs.select(are_sure)
        cover_by(free, 0, 0, sure.table, sure.pools)
        follow(image, all_free, free, elapsed, shown, before, time)
        forget(ghosts.table, image, before, time)
        stays = (time >= STAYS) & (free > 0.7)
        return type(self)(shown, before, time, _large_parts(stays, least_area))

    def layers(self) -> LayerStack:
        """Return the parts that have been left behind as a layer."""
        left, top, width, height = cv2.boundingRect(self.parts.view(np.uint8))
        if not width:
            return NO_LAYERS
        window = np.s_[top : top + height, left : left + width]
        shown = np.ascontiguousarray(self.shown[window])
        planes = to_planes(shown if shown.shape[2] == 3 else shown[:, :, 0]).reshape(-1, height, width)
        mask = np.float32(COVER) * self.parts[window]
        return LayerStack([Layer(top, left, mask, planes, COLOUR_VARIANCE, OUTLIERS)])


@compiled
def _approach(known, seen, share):
    """Let numbers come nearer to what is seen: by `share` 256ths of the difference, a grey level or more."""
    for k in range(known.size):
        apart = np.int32(seen[k]) - np.int32(known[k])
        known[k] += np.uint8((apart * share + np.int32(255) * np.int32(apart > 0)) >> np.int32(8))


@compiled
def follow(image, all_free, free, elapsed, shown, before, time):
    """Follow the colours of a picture, in place, `elapsed` s after the last frame.

    `all_free` and `free` `(height, width)` are what all blobs, and those that may leave something behind,
    leave free; the other arrays are of `LeftBehind`.
    """
    channels = image.shape[2]
    pixels, own, empty, times = image.reshape(-1), shown.reshape(-1), before.reshape(-1), time.reshape(-1)
    scene_share = np.int32(max(256 * (1 - np.exp(-elapsed / SCENE_TIME)), 1))
    own_share = np.int32(max(256 * (1 - np.exp(-elapsed / OWN_TIME)), 1))
    open_, outside = all_free.reshape(-1), free.reshape(-1)
    for first in range(0, times.size, SPAN):
        end = min(first + SPAN, times.size)
        span = slice(channels * first, channels * end)
        if _is_bare(open_[first:end], times[first:end]) and _is_same(pixels[span], empty[span]):
            _approach(empty[span], pixels[span], scene_share)
            for i in range(first, end):
                times[i] = max(times[i] - _f4(elapsed), _f4(-SURE))
            continue
        for i in range(first, end):
            here = slice(channels * i, channels * (i + 1))
            inside, touched = outside[i] < _f4(0.5), times[i] > _f4(0)
            left = colour_gap(pixels, empty, i, channels)
            if touched:
                stay = colour_gap(pixels, own, i, channels)
                if stay < _f4(SURPRISE * NOISE) and left - stay > _f4(2 * NOISE * LEAST_RATIO):
                    times[i] = min(times[i] + _f4(elapsed), _f4(STAYS + PATIENCE))
                    _approach(own[here], pixels[here], own_share)
                elif inside and times[i] < _f4(STAYS):
                    times[i] = _f4(BEGUN)
                    own[here] = pixels[here]
                elif not inside:
                    times[i] -= _f4(elapsed)
                    if times[i] < _f4(STAYS):
                        times[i] = _f4(0)
            elif inside and times[i] <= _f4(-STAYS):
                times[i] = _f4(BEGUN)
                own[here] = pixels[here]
            elif open_[i] > _f4(BARE):
                if left < _f4(SURPRISE * NOISE):
                    times[i] = max(times[i] - _f4(elapsed), _f4(-SURE))
                    _approach(empty[here], pixels[here], scene_share)
                else:
                    times[i] = min(times[i] + _f4(elapsed), _f4(0))
                    if times[i] == _f4(0):
                        empty[here] = pixels[here]


@compiled
def _is_bare(open_, times):
    """Whether no pixel of a span is held by a mask, or has been."""
    held = 0
    for i in range(open_.size):
        held += np.int32(open_[i] <= _f4(BARE)) + np.int32(times[i] > _f4(0))
    return held == 0


@compiled
def _is_same(seen, known):
    """Whether all numbers of a span are what is known, but for noise."""
    others = 0
    for k in range(seen.size):
        others += np.int32(abs(np.int32(seen[k]) - np.int32(known[k])) > np.int32(SAME))
    return others == 0


@compiled
def forget(ghosts, image, before, time):
    """Take, in place, what the patches of ghosts show for the scene; the arrays are of `LeftBehind`."""
    height, width = time.shape
    for k in range(ghosts.size):
        top, left = corner_of(ghosts[k])
        for y in range(max(top, 0), min(top + ghosts[k].rows, height)):
            for x in range(max(left, 0), min(left + ghosts[k].columns, width)):
                time[y, x] = _f4(0)
                for channel in range(image.shape[2]):
                    before[y, x, channel] = image[y, x, channel]


def _large_parts(stays: NDArray[np.bool_], least_area: float) -> NDArray[np.bool_]:
    """Pixels `(height, width)` of connected parts that are large and thick enough for an object."""
    parts = np.zeros_like(stays)
    left, top, width, height = cv2.boundingRect(stays.view(np.uint8))
    if not width:
        return parts
    window = np.s_[top : top + height, left : left + width]
    rough = np.ascontiguousarray(stays[window]).view(np.uint8)
    smooth = cv2.morphologyEx(rough, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(smooth, connectivity=8)
    lengths = boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    large = boxes[:, cv2.CC_STAT_AREA] >= np.maximum(least_area, THINNEST * lengths**2)
    large[0] = False
    parts[window] = large[labels]
    return parts
