"""Objects that move in front of a background, as soft masks with colours: what is known of them.

All blobs of a frame are one table, their pixels in two flat arrays; a single one, taken out, is a `Blob`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.camera.moving_camera import AffineMap
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import FOOT_X, FOOT_Y, HEIGHT, WIDTH
from ...models.pixels.kernels import Pools
from .kernels.blobs import MARGIN, RECORD, UNKNOWN_COLOUR, MaskShape, fill_boxes, shape_of, sweep

Map = NDArray[np.float32]
Pair = NDArray[np.float64]
Box = tuple[float, float, float, float]
Covariance = tuple[tuple[float, float], tuple[float, float]]

Words = NDArray[np.int64]
Mask = NDArray[np.bool_]

HALF_OVERLAP = 0.37
"""Sum of a box's errors, each as a share of its side, at which it shares half of its area with the true one.

Two boxes of one size that are off by a and b of their sides share (1 - a) (1 - b) / (2 - (1 - a) (1 - b)).
"""

OWN_WAY = 3.0
"""s after which what still moves, as small as it is, is somebody by itself."""

WORDS = RECORD.itemsize // 8

_PLAIN = (
    "spread", "seen", "unseen", "still", "confidence", "view", "past_views", "fragment_time", "parting",
    "existence", "noticed",
)  # fmt: skip
_ARRAYS = ("position", "velocity", "covariance", "size")


def around(box: Box, other: Box) -> Box:
    """The box that holds two boxes x, y, width, height."""
    left, top = min(box[0], other[0]), min(box[1], other[1])
    right, bottom = max(box[0] + box[2], other[0] + other[2]), max(box[1] + box[3], other[1] + other[3])
    return left, top, right - left, bottom - top


@short_repr
@dataclass(frozen=True)
class Track:
    """What is reported of an object in a frame.

    Parameters
    ----------
    identity
        from 1, never used twice.
    box
        x, y, width, height px; x, y is the top left corner, 0 at the picture's.
    confidence
        share of the object's visible part that was seen, 0 to 1; 0 while it is hidden or not found. A missing
        frame leaves it as it was. Of who was detected it is the probability that there is such an object.
    velocity
        px/s to the right and down.
    seen
        whether this frame shows it, to its pixels or to a detector; else it is only predicted.
    position_covariance
        px^2, of the middle of the box, along x and y.
    """

    identity: int
    box: Box
    confidence: float
    velocity: tuple[float, float]
    seen: bool
    position_covariance: Covariance

    def seen_by(self, view: AffineMap) -> Self:
        """The same as a frame shows it whose camera has moved by `view`; its velocity stays the scene's."""
        linear = view.matrix[:, :2]
        vx, vy = (linear @ self.velocity).tolist()
        (xx, xy), (yx, yy) = (linear @ self.position_covariance @ linear.T).tolist()
        return replace(
            self, box=view.box(self.box), velocity=(vx, vy), position_covariance=((xx, xy), (yx, yy))
        )


def middle_covariance(variance: Pair) -> Covariance:
    """Of a box's middle: its foot's, and half its height's, of `(4,)` px^2 as of `ObjectBoxes`."""
    return (
        (float(variance[FOOT_X]), 0.0),
        (0.0, float(variance[FOOT_Y] + 0.25 * variance[HEIGHT])),
    )


@short_repr
@dataclass(frozen=True, eq=False)
class DetectedBox:
    """Box of an object as a detector finds it.

    Parameters
    ----------
    mean
        `(4,)` px: foot x and y from the top left corner of the blob's patch, width, height.
    variance
        `(4,)` px^2.
    unfound
        s since a box was last found that may be its.
    """

    mean: Pair
    variance: Pair
    unfound: float = 0.0


@short_repr
@dataclass(frozen=True, eq=False)
class Blob:
    """State of one object.

    Parameters
    ----------
    identity
        from 1.
    position, velocity
        `(2,)` px and px/s, (down, right), of the patch's top left corner.
    covariance
        `(2, 2)` of position and velocity along either axis.
    mask
        `(height, width)` float32 probability of covering a pixel.
    appearance
        `(channels, height, width)` float32 planes; none where no image has shown it yet.
    spread
        squared grey levels: variance of its colours about `appearance`.
    seen
        s for which it was seen.
    unseen, still
        s since it was last seen, and for which it has not moved.
    confidence
        share of its visible part that was seen in the last frame.
    view, past_views
        nats, log ratio of being a ghost and being real by its outline as it is now, and by how it was before
        (see `kernels.learning`).
    fragment_time
        s for which it has been much smaller than anybody where it stands.
    whole
        identity of the object that it is a part of; its own if it is one itself.
    origin
        x, y, width, height px of where it appeared.
    parting
        s for which it has seemed to be two beside each other.
    size
        `(2,)` px, its usual height and width.
    existence
        log odds that it is one of those that the detector is made to find, if there is one.
    noticed
        log odds that the detector finds it at present, if it is in sight.
    detected
        its box for the detector; `None` as long as it has not found it.
    """

    identity: int
    position: Pair
    velocity: Pair
    covariance: Pair
    mask: Map
    appearance: Map
    spread: float
    seen: float
    unseen: float
    still: float
    confidence: float
    view: float
    past_views: float
    fragment_time: float
    whole: int
    origin: Box
    parting: float
    size: Pair
    existence: float = 0.0
    noticed: float = 0.0
    detected: DetectedBox | None = None

    @classmethod
    def newborn(
        cls,
        identity: int,
        corner: Pair,
        mask: Map,
        planes: Map,
        first_speed: float,
        spread: float,
    ) -> Self:
        """An object that was never seen before.

        Parameters
        ----------
        identity
            from 1.
        corner
            `(2,)` px, top and left of its patch.
        mask
            `(height, width)`, with a border of `MARGIN`.
        planes
            `(channels, height, width)` of the image.
        first_speed
            of its own lengths in a second, standard deviation of its velocity.
        spread
            squared grey levels, of its colours.
        """
        size = np.array(mask.shape) - 2.0 * MARGIN
        return cls(
            identity=identity,
            position=corner,
            velocity=np.zeros(2),
            covariance=np.diag([1.0, (first_speed * size.max()) ** 2]),
            mask=mask,
            appearance=np.where(mask > 0.2, planes, np.float32(UNKNOWN_COLOUR)),
            spread=spread,
            seen=0.0,
            unseen=0.0,
            still=0.0,
            confidence=1.0,
            view=0.0,
            past_views=0.0,
            fragment_time=0.0,
            whole=identity,
            origin=(float(corner[1]) + MARGIN, float(corner[0]) + MARGIN, float(size[1]), float(size[0])),
            parting=0.0,
            size=size,
        )

    @cached_property
    def corner(self) -> tuple[int, int]:
        """Top and left px of the patch, as it is rendered."""
        return math.floor(self.position[0] + 0.5), math.floor(self.position[1] + 0.5)

    @cached_property
    def shape(self) -> MaskShape:
        """Measures of the mask."""
        return shape_of(self.mask)

    @cached_property
    def box(self) -> Box:
        """x, y, width, height px of what the mask likely covers, or else of its patch."""
        top, left, bottom, right = self.shape[1:5]
        if bottom == 0 or right == 0:
            (top, left), (bottom, right) = (0, 0), self.mask.shape
        y, x = self.position.tolist()
        return x + left, y + top, float(right - left), float(bottom - top)

    @property
    def reported_box(self) -> tuple[float, float, float, float]:
        """x, y, width, height px: as detections have it, or else as the mask."""
        if self.detected is None:
            return self.box
        x, y, width, height = self.detected.mean.tolist()
        top, left = self.position.tolist()
        return left + x - 0.5 * width, top + y - height, width, height

    @property
    def length(self) -> float:
        """px, the longer side of the box."""
        return max(self.reported_box[2:])

    def moved_patch(self, shift: NDArray[Any]) -> Self:
        """The same with another top left corner, px down and right of the old; the mask must follow."""
        box = self.detected
        if box is not None:
            box = replace(box, mean=box.mean - (shift[1], shift[0], 0, 0))
        return self.changed(position=self.position + shift, detected=box)

    def changed(self, **values: Any) -> Self:
        """Like `dataclasses.replace`, but what was measured of a mask that stays is kept."""
        kept = {
            name: value for name, value in self.__dict__.items() if name not in ("corner", "shape", "box")
        }
        blob = object.__new__(type(self))
        blob.__dict__.update(kept | values)
        if "mask" not in values and "shape" in self.__dict__:
            blob.__dict__["shape"] = self.shape
        return blob


@short_repr
@dataclass(frozen=True, eq=False)
class Blobs(Sequence[Blob]):
    """Blobs as rows of a table, in no particular order.

    Loops over all of them take the table; a single one, taken out, is a `Blob` that refers to the same
    pixels. Like any state it is never changed once it is made.

    Parameters
    ----------
    words
        `(n, WORDS)` int64: records of type `RECORD`, bit by bit.
    masks
        float32, of all blobs one after the other.
    colours
        float32, likewise, plane by plane of each blob.
    channels
        of the colours, 1 or 3.
    """

    words: Words
    masks: Map
    colours: Map
    channels: int

    def __post_init__(self) -> None:
        if self.words.ndim != 2 or self.words.shape[1] != WORDS:
            raise ValueError(f"blobs: got records of shape {self.words.shape}, expected (n, {WORDS})")

    @classmethod
    def none(cls, channels: int) -> Self:
        """No blobs, for pictures of so many channels."""
        nothing = np.zeros(0, np.float32)
        return cls(np.zeros((0, WORDS), np.int64), nothing, nothing, channels)

    @classmethod
    def of(cls, blobs: Sequence[Blob], channels: int) -> Self:
        """Blobs that are on their own, in their order."""
        table = np.zeros(len(blobs), RECORD)
        ends = np.cumsum([0, *(blob.mask.size for blob in blobs)])
        masks, colours = np.empty(ends[-1], np.float32), np.zeros(channels * ends[-1], np.float32)
        for blob, record, start, end in zip(blobs, table, ends.tolist(), ends[1:].tolist(), strict=False):
            _write(blob, record, start)
            masks[start:end] = blob.mask.reshape(-1)
            if len(blob.appearance):
                colours[channels * start : channels * end] = blob.appearance.reshape(-1)
        return cls(table.view(np.int64).reshape(-1, WORDS), masks, colours, channels)

    @cached_property
    def table(self) -> NDArray[np.void]:
        """`(n,)` records."""
        return self.words.view(RECORD)[:, 0]

    @cached_property
    def pools(self) -> Pools:
        """Masks and colours, for loops."""
        return Pools(self.masks, self.colours)

    @cached_property
    def _boxes(self) -> tuple[Pair, Pair]:
        boxes, reported = np.empty((2, len(self.words), 4))
        fill_boxes(self.table, boxes, reported)
        return boxes, reported

    @property
    def boxes(self) -> Pair:
        """`(n, 4)` x, y, width, height px of what masks likely cover."""
        return self._boxes[0]

    @property
    def reported_boxes(self) -> Pair:
        """`(n, 4)` px: as detections have them, or else as the masks."""
        return self._boxes[1]

    @property
    def feet(self) -> Pair:
        """`(n,)` px, the lowest row: what stands lower in the picture is nearer."""
        return self.reported_boxes[:, 1] + self.reported_boxes[:, 3]

    @property
    def ghost_evidence(self) -> Pair:
        """`(n,)` nats, log ratio of being a ghost and being real; a detector finds what is real."""
        table = self.table
        real = np.where(table["detected"], np.maximum(table["existence"], 0.0), 0.0)
        evidence: Pair = table["view"] + table["past_views"] - real
        return evidence

    @property
    def reported_variances(self) -> Pair:
        """`(n, 4)` px^2 of foot x and y, width and height: of places, and of the detected boxes there."""
        table = self.table
        variances = np.where(table["detected"][:, None], table["box_variance"], 0.0)
        variances[:, :WIDTH] += table["covariance"][:, 0, :1]
        return variances

    @property
    def existence_probability(self) -> Pair:
        """`(n,)`: that it is one of those that the detector is made to find."""
        probability: Pair = 1 / (1 + np.exp(-self.table["existence"]))
        return probability

    @property
    def are_likely(self) -> Mask:
        """`(n,)`: whether it likely exists, and covers half of the box that was detected."""
        likely = np.zeros(len(self), bool)
        found = np.flatnonzero(self.table["detected"])
        sides = np.tile(self.table["box_mean"][found, 2:], 2)
        off = np.array([1.0, 1.0, 0.5, 0.5]) * np.sqrt(self.reported_variances[found]) / sides
        # overlap is lost by the sum of four errors, whose sizes are half normal; sides that grow lose none
        mean = math.sqrt(2 / math.pi) * off.sum(axis=1)
        deviation = math.sqrt(1 - 2 / math.pi) * np.sqrt((off**2).sum(axis=1))
        for k, margin in zip(found.tolist(), (HALF_OVERLAP - mean) / (math.sqrt(2) * deviation), strict=True):
            likely[k] = (0.5 + 0.5 * math.erf(margin)) * self.existence_probability[k] > 0.5
        return likely

    @property
    def are_fragments(self) -> Mask:
        """`(n,)`: whether it is a piece of somebody; what is small by nature has moved alone for long."""
        time = self.table["fragment_time"]
        fragments: Mask = (time > 0) & ~((time > OWN_WAY) & (self.table["still"] == 0))
        return fragments

    def __len__(self) -> int:
        return len(self.words)

    def __iter__(self) -> Iterator[Blob]:
        return (self[k] for k in range(len(self.words)))

    @overload
    def __getitem__(self, index: int, /) -> Blob: ...
    @overload
    def __getitem__(self, index: slice, /) -> list[Blob]: ...
    def __getitem__(self, index: int | slice, /) -> Blob | list[Blob]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        record = self.table[index]
        shape, start = (int(record["rows"]), int(record["columns"])), int(record["start"])
        end = start + shape[0] * shape[1]
        known = self.channels if record["coloured"] else 0
        box = None
        if record["detected"]:
            box = DetectedBox(record["box_mean"], record["box_variance"], float(record["unfound"]))
        values: dict[str, Any] = {name: float(record[name]) for name in _PLAIN}
        values |= {name: record[name] for name in _ARRAYS}
        blob = Blob(
            identity=int(record["identity"]),
            whole=int(record["whole"]),
            mask=self.masks[start:end].reshape(shape),
            appearance=self.colours[self.channels * start : self.channels * start + known * (end - start)]
            .reshape(known, *shape),
            origin=tuple(record["origin"].tolist()),
            detected=box,
            **values,
        )  # fmt: skip
        blob.__dict__["shape"] = MaskShape(*(record[name].item() for name in MaskShape._fields))
        return blob

    def with_table(self, table: NDArray[np.void]) -> Self:
        """Other records of the same pixels."""
        return replace(self, words=table.view(np.int64).reshape(-1, WORDS))

    def sweep(self, due: Mask) -> None:
        """Free the masks of those that are `due` `(n,)`, and that nobody else knows yet, of crumbs."""
        if due.any():
            sizes, columns = self.table["rows"] * self.table["columns"], self.table["columns"]
            memory, scratch = np.empty(3 * sizes.max(), np.int64), np.empty(5 * columns.max(), np.float32)
            sweep(self.table, self.pools, due, memory, scratch)

    def taken(self, which: NDArray[np.intp] | Mask) -> Self:
        """Some of them, by their numbers or whether to take them."""
        return replace(self, words=self.words[which])

    def and_also(self, blobs: Sequence[Blob]) -> Self:
        """All of them and some new ones."""
        if not blobs:
            return self
        others = Blobs.of(blobs, self.channels)
        others.table["start"] += len(self.masks)
        return type(self)(
            np.concatenate([self.words, others.words]),
            np.concatenate([self.masks, others.masks]),
            np.concatenate([self.colours, others.colours]),
            self.channels,
        )


def _write(blob: Blob, record: np.void, start: int) -> None:
    """Write all that is known of a blob but its pixels, which lie at `start`."""
    for name in ("identity", "whole", "origin", *_PLAIN, *_ARRAYS):
        record[name] = getattr(blob, name)
    record["start"], (record["rows"], record["columns"]) = start, blob.mask.shape
    record["coloured"], record["detected"] = len(blob.appearance) > 0, blob.detected is not None
    if blob.detected is not None:
        record["box_mean"], record["box_variance"] = blob.detected.mean, blob.detected.variance
        record["unfound"] = blob.detected.unfound
    for name, value in zip(MaskShape._fields, blob.shape, strict=True):
        record[name] = value


def union(boxes: Pair) -> Pair:
    """The box that holds all boxes `(n, 4)` x, y, width, height."""
    first, end = boxes[:, :2].min(axis=0), (boxes[:, :2] + boxes[:, 2:]).max(axis=0)
    return np.concatenate([first, end - first])


@short_repr
@dataclass(frozen=True, eq=False)
class BlobState:
    """All objects of a scene.

    Parameters
    ----------
    blobs
        in no particular order.
    born
        how many there have been.
    size
        `(height, width)` px of the picture.
    elapsed
        s since the last frame with an image.
    confirmed_time
        s for which an object must have been seen before it is reported.
    detecting
        whether a detector has run, which decides what is reported.
    """

    blobs: Blobs
    born: int
    size: tuple[int, int]
    elapsed: float
    confirmed_time: float
    detecting: bool = False

    def tracks(self) -> list[Track]:
        """Objects that are sure enough to be reported, by identity.

        Once a detector has run, they are those that it has found, and that likely exist where they are said
        to be.
        """
        blobs, table = self.blobs, self.blobs.table
        if not len(table):
            return []
        found = table["detected"] != 0
        sure = blobs.are_likely if self.detecting else table["seen"] >= self.confirmed_time
        parts: dict[int, list[int]] = {}
        for k in np.flatnonzero(sure & (found | ~blobs.are_fragments)).tolist():
            parts.setdefault(int(table["whole"][k]), []).append(k)
        confidence = np.where(found, blobs.existence_probability, table["confidence"])
        shown = ((table["unseen"] == 0) & (self.elapsed == 0)) | (found & (table["unfound"] == 0))
        return [_track(identity, parts[identity], blobs, confidence, shown) for identity in sorted(parts)]


def _track(identity: int, parts: list[int], blobs: Blobs, confidence: Pair, shown: Mask) -> Track:
    """What is reported of an object with these parts."""
    largest = parts[0] if len(parts) == 1 else parts[int(np.argmax(blobs.table["mass"][parts]))]
    boxes = blobs.reported_boxes[parts]
    x, y, width, height = (boxes[0] if len(parts) == 1 else union(boxes)).tolist()
    speed_y, speed_x = blobs.table["velocity"][largest].tolist()
    covariance = middle_covariance(blobs.reported_variances[largest])
    return Track(
        identity,
        (x, y, width, height),
        float(confidence[largest]),
        (speed_x, speed_y),
        bool(shown[parts].any()),
        covariance,
    )


def box_densities(identities: ArrayLike, boxes: ArrayLike) -> GaussianMessage:
    """Where objects stand and how large they look, `(n, 4)` px, as a message to `ObjectBoxes`."""
    x, y, width, height = np.asarray(boxes, np.float64).T
    deviations = np.stack([0.05 * width, 0.03 * height, 0.15 * width, 0.08 * height], axis=1) + 1
    return GaussianMessage.from_moments(
        np.asarray(identities, np.int64),
        np.stack([x + 0.5 * width, y + height, width, height], axis=1),
        deviations[:, :, None] ** 2 * np.eye(4),
    )


def likely_size(mask: Map) -> Pair:
    """Height and width px of what a mask likely covers, at least 1."""
    shape = shape_of(mask)
    return np.array([max(shape.bottom - shape.top, 1.0), max(shape.right - shape.left, 1.0)])


def paste(out: Map, top: int, left: int, source: Map, source_top: int, source_left: int) -> None:
    """Copy the common part of two placed arrays `(..., height, width)`."""
    first_row, first_column = max(top, source_top), max(left, source_left)
    end_row = min(top + out.shape[-2], source_top + source.shape[-2])
    end_column = min(left + out.shape[-1], source_left + source.shape[-1])
    if first_row < end_row and first_column < end_column:
        out[..., first_row - top : end_row - top, first_column - left : end_column - left] = source[
            ...,
            first_row - source_top : end_row - source_top,
            first_column - source_left : end_column - source_left,
        ]
