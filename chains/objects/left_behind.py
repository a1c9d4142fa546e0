"""What objects leave behind: places that still show an object's colours although it has moved on.

A bag at its owner's feet is a part of his mask, which loses it where it hardly differs from the ground. Of
each pixel that an object has covered, the colour L_t is compared with A, which it has shown since, and with
E, which it showed before any object came:

    log p(L_t | stays) / p(L_t | left) = (|L_t - E|^2 - |L_t - A|^2) / (2 NOISE)

As A is known, a difference from E is seen that is too small to tell any colour from the ground. Parts that
stay for longer than a foot stands in a step, and that no mask holds any more, are layers of their own until
they show another colour. Where no object is, E follows the image; where A stays, A does. E is known once
it has been shown for as long, and longer than other colours since, so that it is no earlier object's.

All of this takes a second, so that ten looks a second are enough.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import NotNegative, Shape
from ...models.core.short_repr import short_repr
from ...models.numerics.compiled import compiled, inlined
from ...models.numerics.threads import over_bands
from ...models.pixels.background import SPAN, foreground_spans
from ...models.pixels.colour import colour_gap, to_planes
from ...models.pixels.layers import NO_LAYERS, Layer, LayerStack
from .blob_records import THINNEST, corner_of, cover_by

if TYPE_CHECKING:
    from .blobs import Blobs

_f4 = np.float32

NOISE = 30.0  # squared grey levels, of a colour about the one that it stays
SURPRISE = 9.2  # squared distance over the noise that one in a hundred exceeds
NEAR_OF_COLOUR, NEAR_OF_GREY = 8, 16
"""Powers of 2: less in all channels is no surprise. (Planes are apart by 4.7 times the square at most.)"""
LEAST_RATIO = 0.5  # nats of a pixel, from which on it stays rather than that the object has left
STAYS = 1.0  # s; a foot stands for .6 s in a step
SURE = 2 * STAYS  # s for which E has been shown at most: another colour is the scene after as long
BEGUN = 1e-3  # s, of what an object has just brought
PATIENCE = 0.2  # s for which what stays may look otherwise
LOOK = 0.1  # s between two looks: a fraction of what it takes to stay, and of what may be missed
BAND = 8  # rows of a picture whose covers are in the cache
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
    unseen: NotNegative = 0.0  # s since the last look

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
        nothing has been. Parts have `least_area` px or more, and are no lines. If the last look was less than
        `LOOK` ago, and there are no ghosts, all stays as it is.
        """
        elapsed += self.unseen
        if elapsed < LOOK and not len(ghosts):
            return replace(self, unseen=elapsed)
        known: Any = self.shown, self.before, self.time
        stays = np.zeros(self.time.shape, np.bool_)
        shown, before, time = after = self.shown.copy(), np.empty_like(self.before), np.empty_like(self.time)
        sure, spent, channels = blobs.table[are_sure], np.float32(elapsed), tuple(range(image.shape[2]))

        def look(first: int, end: int) -> None:
            here = slice(first, end)
            seen = image[here].reshape(-1)
            old, new = (tuple(each[here].reshape(-1) for each in arrays) for arrays in (known, after))
            follow_scene(seen, *old[1:], spent, *new[1:])
            follow(
                first, image.shape[1], seen, channels, blobs.table, sure, blobs.pools, spent, old, new,
                stays[here].reshape(-1),
            )  # fmt: skip

        over_bands(look, len(image))
        forget(ghosts.table, image, before, time, stays)
        return type(self)(shown, before, time, _large_parts(stays, least_area))

    def layers(self) -> LayerStack:
        """Return the parts that have been left behind as a layer."""
        rows, columns = window = _window(self.parts)
        shown = np.ascontiguousarray(self.shown[window])
        if not shown.size:
            return NO_LAYERS
        planes = to_planes(shown if shown.shape[2] == 3 else shown[:, :, 0]).reshape(-1, *shown.shape[:2])
        mask = np.float32(COVER) * self.parts[window]
        return LayerStack([Layer(rows.start, columns.start, mask, planes, COLOUR_VARIANCE, OUTLIERS)])


@inlined
def _approached(known, seen, share):
    """Return a number nearer to what is seen: by `share` 256ths, a grey level or more unless it is 0.

    Of 16 bits throughout, which are twice as many a vector as of 32.
    """
    upwards = seen > known
    apart = np.uint16(seen - known) if upwards else np.uint16(known - seen)
    step = np.uint8(np.uint16(np.uint16(apart * share) + np.uint16(255)) >> np.uint16(8))
    return np.uint8(known + step) if upwards else np.uint8(known - step)


@inlined
def _share(elapsed, time):
    """The share of a difference that is followed, 256ths."""
    return np.uint16(max(256 * (1 - np.exp(-elapsed / time)), 1))


@compiled
def follow_scene(pixels, empty, times, elapsed, new_empty, new_times):
    """Follow the colours of a picture, and for how long they have been seen, as if all showed the scene."""
    share = _share(elapsed, SCENE_TIME)
    for k in range(pixels.size):
        new_empty[k] = _approached(empty[k], pixels[k], share)
    for i in range(times.size):
        new_times[i] = max(times[i] - elapsed, _f4(-SURE))


@compiled
def follow(first, width, image, channels, blobs, sure, pools, elapsed, known, after, stays):
    """Follow the colours of pixels that do not show the scene, `elapsed` s after the last frame.

    `image` is the part of a picture from row `first` on, in one row, as are all arrays. `channels` are the
    numbers of its channels as a tuple: how many there are is known when this is compiled. `blobs` and `sure`
    are the tables of all blobs, and of those that may leave something behind. `known` and `after` are
    `shown`, `before` and `time` of `LeftBehind` before and after the frame, and `after` as if all showed the
    scene (see `follow_scene`); of `stays` what stays becomes true.
    """
    height = stays.size // width
    free, signs = np.empty((2, BAND * width), np.float32), np.empty(BAND * width, np.int8)
    spans = np.empty(signs.size // SPAN + 1, np.int64)
    for top in range(0, height, BAND):
        here = slice(top * width, min(top + BAND, height) * width)
        colours, size = slice(len(channels) * here.start, len(channels) * here.stop), here.stop - here.start
        free[:] = _f4(1)
        cover_by(free[0, :size].reshape(-1, width), first + top, 0, blobs, pools)
        cover_by(free[1, :size].reshape(-1, width), first + top, 0, sure, pools)
        own, new_own = known[0][colours], after[0][colours]
        empty, new_empty, times, new_times = (
            known[1][colours],
            after[1][colours],
            known[2][here],
            after[2][here],
        )
        _follow_others(
            channels, image[colours], own, empty, times, free, elapsed, signs[:size], spans, new_own,
            new_empty, new_times, stays[here],
        )  # fmt: skip


@compiled
def _any_apart(some, others):
    """All bits of the absolute differences of grey levels: less than a power of 2 if all these are."""
    bits = np.uint8(0)
    for k in range(some.size):
        bits |= np.uint8(max(some[k], others[k]) - min(some[k], others[k]))
    return bits


@compiled
def _follow_others(
    channels, pixels, own, empty, times, free, elapsed, signs, spans, new_own, new_empty, new_times, stays
):
    """Follow the colours of pixels that do not show the scene, or have been covered: their sign is -1."""
    surprise, near = _f4(SURPRISE * NOISE), NEAR_OF_COLOUR if len(channels) == 3 else NEAR_OF_GREY
    for i in range(times.size):
        signs[i] = np.int8(-1) if (free[0, i] <= _f4(BARE)) | (times[i] > _f4(0)) else np.int8(0)
    for start in range(0, times.size, SPAN):
        end = min(start + SPAN, times.size)
        colours = slice(len(channels) * start, len(channels) * end)
        seen, expected, out = pixels[colours], empty[colours], signs[start:end]
        if _any_apart(seen, expected) >= near:
            for i in range(out.size):
                strange = colour_gap(seen, expected, i, len(channels)) >= surprise
                out[i] = np.int8(-1) if strange else out[i]
    scene_share, own_share = _share(elapsed, SCENE_TIME), _share(elapsed, OWN_TIME)
    for span in range(foreground_spans(signs, spans)):
        for i in range(spans[span], min(spans[span] + SPAN, times.size)):
            if signs[i] == 0:
                continue
            left, inside, time = colour_gap(pixels, empty, i, len(channels)), free[1, i] < _f4(0.5), times[i]
            own_rate, scene_rate = np.uint16(0), np.uint16(0)
            if time > _f4(0):
                stay = colour_gap(pixels, own, i, len(channels))
                if stay < surprise and left - stay > _f4(2 * NOISE * LEAST_RATIO):
                    time, own_rate = min(time + elapsed, _f4(STAYS + PATIENCE)), own_share
                elif inside and time < _f4(STAYS):
                    time, own_rate = _f4(BEGUN), np.uint16(256)
                elif not inside:
                    time -= elapsed
                    time = time if time >= _f4(STAYS) else _f4(0)
            elif inside and time <= _f4(-STAYS):
                time, own_rate = _f4(BEGUN), np.uint16(256)
            elif free[0, i] > _f4(BARE):
                if left < surprise:
                    time, scene_rate = max(time - elapsed, _f4(-SURE)), scene_share
                else:
                    time = min(time + elapsed, _f4(0))
                    scene_rate = np.uint16(256) if time == _f4(0) else np.uint16(0)
            new_times[i], stays[i] = time, (time >= _f4(STAYS)) & (free[1, i] > _f4(0.7))
            for channel in range(len(channels)):
                k = len(channels) * i + channel
                new_own[k] = _approached(own[k], pixels[k], own_rate)
                new_empty[k] = _approached(empty[k], pixels[k], scene_rate)


@compiled
def forget(ghosts, image, before, time, stays):
    """Take, in place, what the patches of ghosts show for the scene; see `follow` for the arrays."""
    height, width = time.shape
    for k in range(ghosts.size):
        top, left = corner_of(ghosts[k])
        for y in range(max(top, 0), min(top + ghosts[k].rows, height)):
            for x in range(max(left, 0), min(left + ghosts[k].columns, width)):
                time[y, x], stays[y, x] = _f4(0), False
                for channel in range(image.shape[2]):
                    before[y, x, channel] = image[y, x, channel]


def _large_parts(stays: NDArray[np.bool_], least_area: float) -> NDArray[np.bool_]:
    """Pixels `(height, width)` of connected parts that are large and thick enough for an object."""
    parts = np.zeros_like(stays)
    window = _window(stays)
    rough = stays[window]
    if not rough.size:
        return parts
    smooth = cv2.morphologyEx(rough.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    within = _window(smooth)
    if not smooth[within].size:
        return parts
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(smooth[within], connectivity=8)
    lengths = boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    large = boxes[:, cv2.CC_STAT_AREA] >= np.maximum(least_area, THINNEST * lengths**2)
    large[0] = False
    parts[window][within] = large[labels]
    return parts


def _window(mask: NDArray[Any]) -> tuple[slice, slice]:
    """Return the rows and columns of a mask of bytes in which it is not 0."""
    left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
    return np.s_[top : top + height, left : left + width]
