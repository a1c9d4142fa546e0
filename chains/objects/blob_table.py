"""All blobs of a frame as one table, their pixels in two flat arrays; and the state of their chain."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, overload

import numpy as np
from numpy.typing import NDArray

from ...models.core.short_repr import short_repr
from ...models.objects.box_detector import WIDTH
from ...models.pixels.kernels.layers import Pools
from .blobs import Blob, DetectedBox, Map, Pair, Track, middle_covariance
from .kernels.masks import MaskShape, sweep
from .kernels.records import RECORD, fill_boxes

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
