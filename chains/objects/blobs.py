"""Objects that move in front of a background, as soft masks with colours: what is known of them."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.camera.moving_camera import View
from ...models.core.checks import Bound, CountFrom0, NotNegative, Shape, SizesOf
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import FOOT_X, FOOT_Y, HEIGHT, WIDTH
from ...models.pixels.layers import LAYER, LayerSheet, Pools, log_density_ratio
from .blob_records import MARGIN, RECORD, UNKNOWN_COLOUR, fill_boxes, measure_all, measured, overlap
from .left_behind import LeftBehind

Map = NDArray[np.float32]
Numbers = NDArray[np.float64]
Box = tuple[float, float, float, float]
Covariance = tuple[tuple[float, float], tuple[float, float]]

Words = NDArray[np.int64]
Mask = NDArray[np.bool_]

HALF_OVERLAP = 0.37
"""Sum of a box's errors, each as a share of its side, at which it shares half of its area with the true one.

Two boxes of one size that are off by a and b of their sides share (1 - a) (1 - b) / (2 - (1 - a) (1 - b)).
"""

OWN_WAY = 3.0  # s after which what still moves, as small as it is, is an object by itself

MOST_EVIDENCE = 20.0  # nats, that views of an outline are worth together, either way

COVERED, CRUMB = 0.3, 0.1
"""Probability of cover from which on pixels make a spot, and share of the largest that crumbs have not."""

WORDS = RECORD.itemsize // 8  # of 8 bytes, of one blob
PLACES, FARTHEST = ("position", "velocity", "size", "origin", "box_mean"), 1e9  # px
"""Fields of records that loops round to whole numbers, and what is beyond any picture."""


@short_repr
@dataclass(frozen=True)
class Track:
    """Reported state of an object in a frame."""

    identity: int  # from 1, never used twice
    box: Box  # x, y, width, height px; x, y is the top left corner, 0 at the picture's
    # share of its visible part that was seen; of who was detected, the probability to exist
    confidence: float
    velocity: tuple[float, float]  # px/s to the right and down
    seen: bool  # whether this frame shows it, to its pixels or to a detector; else it is only predicted
    position_covariance: Covariance  # px^2, of the middle of the box, along x and y

    def seen_by(self, view: View) -> Self:
        """Return the track in a frame whose camera has moved by `view`; the velocity stays the scene's."""
        linear, (x, y, width, height) = view.map.matrix[:, :2], self.box
        here = np.array([[x + width / 2, y + height, width, height]])
        unsure = np.diag(view.box_variances(here)[0, :WIDTH])
        ((x, y, width, height),) = view.map.boxes(here).tolist()
        vx, vy = (linear @ self.velocity).tolist()
        (xx, xy), (yx, yy) = (linear @ self.position_covariance @ linear.T + unsure).tolist()
        return replace(
            self,
            box=(x - width / 2, y - height, width, height),
            velocity=(vx, vy),
            position_covariance=((xx, xy), (yx, yy)),
        )


def centre_covariance(variance: Numbers) -> Covariance:
    """Return the covariance of a box's centre from `(4,)` px^2 variances of `ObjectBoxes`."""
    return (
        (float(variance[FOOT_X]), 0.0),
        (0.0, float(variance[FOOT_Y] + 0.25 * variance[HEIGHT])),
    )


@short_repr
@dataclass(frozen=True, eq=False)
class Blob:
    """One object: a record, whose fields (see `RECORD`) are attributes, and its pixels."""

    record: np.void  # of type `RECORD`
    mask: Map  # (height, width) probability of covering a pixel
    appearance: Map  # (channels, height, width) planes; none where no image has shown it yet

    @classmethod
    def newborn(
        cls,
        identity: int,
        corner: Numbers,
        mask: Map,
        planes: Map,
        initial_velocity_std: float,
        colour_variance: float,
    ) -> Self:
        """Return an object that was never seen before, with `corner` `(2,)` px the top and left of its patch.

        Its mask `(height, width)` has a border of `MARGIN`; `planes` `(channels, height, width)` are the
        image's there. `initial_velocity_std` is in its own lengths/s, `colour_variance` in grey levels^2.
        """
        size = np.array(mask.shape) - 2.0 * MARGIN
        appearance = np.where(mask > 0.2, planes, np.float32(UNKNOWN_COLOUR))
        return cls(np.zeros(1, RECORD)[0], mask, appearance).changed(
            identity=identity,
            whole=identity,
            position=corner,
            covariance=np.diag([1.0, (initial_velocity_std * size.max()) ** 2]),
            mask=mask,
            colour_variance=colour_variance,
            confidence=1.0,
            origin=(float(corner[1]) + MARGIN, float(corner[0]) + MARGIN, float(size[1]), float(size[0])),
            size=size,
        )

    def __getattr__(self, name: str) -> Any:
        if name not in (RECORD.names or ()):
            raise AttributeError(name)
        return self.record[name]

    @property
    def corner(self) -> tuple[int, int]:
        """Top and left px of the patch, as it is rendered."""
        return math.floor(self.position[0] + 0.5), math.floor(self.position[1] + 0.5)

    @property
    def box(self) -> Box:
        """x, y, width, height px of what the mask likely covers, or else of its patch."""
        x, y, width, height = Blobs.of([self], len(self.appearance)).boxes[0].tolist()
        return x, y, width, height

    def resampled(self, shape: Sequence[int]) -> Self:
        """Return the blob with a patch of `shape` (columns, rows)."""
        mask = cv2.resize(self.mask, shape, interpolation=cv2.INTER_LINEAR)
        planes = [cv2.resize(plane, shape, interpolation=cv2.INTER_NEAREST) for plane in self.appearance]
        return self.changed(
            np.asarray(mask, np.float32), np.array(planes, np.float32).reshape(-1, *mask.shape)
        )

    def part(self, identity: int, mask: Map) -> Self:
        """Return a part of it that has come apart, with a mask `(height, width)`, as a new object.

        It is as sure to be real; but where this one appeared, it may be what that has left behind.
        """
        unknown: dict[str, Any] = dict.fromkeys(("seen", "still", "view", "parting", "fragment_time"), 0.0)
        part = self.changed(mask, identity=identity, whole=identity, size=likely_size(mask), **unknown)
        evidence = 0.0 if overlap(part.box, tuple(self.origin)) else self.past_views
        return part.changed(origin=part.box, past_views=evidence)

    def changed(self, mask: Map | None = None, appearance: Map | None = None, **values: Any) -> Self:
        """Return the blob with other pixels, or other values of fields; a new mask is measured."""
        record = np.array([self.record])[0] if mask is None else measured(mask, self.record)
        for name, value in values.items():
            record[name] = value
        return type(self)(
            record,
            self.mask if mask is None else mask,
            self.appearance if appearance is None else appearance,
        )


@short_repr
@dataclass(frozen=True, eq=False)
class Blobs:
    """Table of blobs, in no particular order; `blobs[k]` is a `Blob`.

    Like any state it is never changed once it is made.
    """

    words: Annotated[Words, Shape("n", WORDS)]  # records of type `RECORD`, bit by bit
    masks: Annotated[Map, Shape("n_pixels")]  # of all blobs one after the other
    colours: Annotated[Map, Shape("channels * n_pixels")]  # likewise, plane by plane of each blob
    channels: Annotated[int, Bound(lambda count: count in (1, 3), "1 or 3")]  # of the colours

    def require_fit(self) -> None:
        """Raise a `ValueError` if a record means other pixels than there are, or places that are none."""
        table, most = self.table, len(self.masks)
        rows, columns, start = table["rows"], table["columns"], table["start"]
        fit = (rows >= 1) & (columns >= 1) & (start >= 0) & (rows <= most) & (columns <= most)
        fit &= (start + rows * columns <= most) & (table["waist"] >= 0) & (table["waist"] <= columns)
        for first, end, length in (("top", "bottom", rows), ("left", "right", columns)):
            for kind in ("", "faint_"):
                fit &= (table[kind + first] >= 0) & (table[kind + end] <= length)
        for name in PLACES:
            near = np.abs(table[name]) < FARTHEST
            fit &= near.reshape(len(table), math.prod(near.shape[1:])).all(axis=1)
        if not fit.all():
            raise ValueError(f"blobs: got a record {int(np.argmin(fit))} of other pixels than there are")

    @classmethod
    def none(cls, channels: int) -> Self:
        """Return a table without blobs, for pictures of so many channels."""
        nothing = np.zeros(0, np.float32)
        return cls(np.zeros((0, WORDS), np.int64), nothing, nothing, channels)

    @classmethod
    def of(cls, blobs: Collection[Blob], channels: int) -> Self:
        """Return the table of single blobs, in their order."""
        table = np.array([blob.record for blob in blobs], RECORD)
        ends = np.cumsum([0, *(blob.mask.size for blob in blobs)])
        masks, colours = np.empty(ends[-1], np.float32), np.zeros(channels * ends[-1], np.float32)
        table["start"], table["coloured"] = ends[:-1], [len(blob.appearance) > 0 for blob in blobs]
        for blob, start, end in zip(blobs, ends.tolist(), ends[1:].tolist(), strict=False):
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
    def _boxes(self) -> tuple[Numbers, Numbers]:
        boxes, reported = np.empty((2, len(self.words), 4))
        fill_boxes(self.table, boxes, reported)
        return boxes, reported

    @property
    def boxes(self) -> Numbers:
        """`(n, 4)` x, y, width, height px of what masks likely cover."""
        return self._boxes[0]

    @property
    def reported_boxes(self) -> Numbers:
        """`(n, 4)` px: the detected boxes, or else those of the masks."""
        return self._boxes[1]

    @property
    def feet(self) -> Numbers:
        """`(n,)` px, lowest row of the box: what stands lower in the picture is nearer."""
        return self.reported_boxes[:, 1] + self.reported_boxes[:, 3]

    @property
    def ghost_evidence(self) -> Numbers:
        """`(n,)` nats, log ratio of ghost and real; being detected counts as real."""
        table = self.table
        real = np.where(table["detected"], np.maximum(table["existence"], 0.0), 0.0)
        return np.asarray(np.minimum(table["view"], MOST_EVIDENCE) + table["past_views"] - real)

    @property
    def reported_variances(self) -> Numbers:
        """`(n, 4)` px^2 of foot x and y, width and height."""
        table = self.table
        variances = np.where(table["detected"][:, None], table["box_variance"], 0.0)
        variances[:, :WIDTH] += table["covariance"][:, 0, :1]
        return variances

    @property
    def existence_probability(self) -> Numbers:
        """`(n,)` probability of being an object that the detector is made to find."""
        return np.asarray(1 / (1 + np.exp(-self.table["existence"])))

    @property
    def are_likely(self) -> Mask:
        """`(n,)`: whether it likely exists, and its box shares half of its area with the true one."""
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
        """`(n,)`: whether it is a piece of a person; small things that move alone for long are not."""
        time = self.table["fragment_time"]
        return np.asarray((time > 0) & ~((time > OWN_WAY) & (self.table["still"] == 0)))

    def __len__(self) -> int:
        return len(self.words)

    def __iter__(self) -> Iterator[Blob]:
        return (self[k] for k in range(len(self.words)))

    def __getitem__(self, index: int) -> Blob:
        record = self.table[index]
        shape, start = (int(record["rows"]), int(record["columns"])), int(record["start"])
        size, known = shape[0] * shape[1], self.channels if record["coloured"] else 0
        first = self.channels * start
        return Blob(
            record,
            self.masks[start : start + size].reshape(shape),
            self.colours[first : first + known * size].reshape(known, *shape),
        )

    def with_table(self, table: NDArray[np.void]) -> Self:
        """Return the blobs with other records of the same pixels."""
        return replace(self, words=table.view(np.int64).reshape(-1, WORDS))

    def sweep(self, number: int, least_area: float) -> list[Map]:
        """Free a mask of crumbs, in place: the table must be a new one; return those of `least_area` px."""
        mask = self[number].mask
        before = mask.copy()
        labels, numbers = take_crumbs(mask)
        if not len(numbers):
            return []
        row = self.table[number : number + 1]
        measure_all(row, self.pools, np.empty(5 * mask.shape[1], np.float32))
        large = np.bincount(labels.ravel(), before.ravel())[numbers] >= least_area
        return [np.where(labels == crumb, before, np.float32(0)) for crumb in numbers[large]]

    def select(self, which: NDArray[np.intp] | Mask) -> Self:
        """Return some of the blobs, by index or by whether to take them."""
        return replace(self, words=self.words[which])

    def seen_by(self, view: View) -> Self:
        """Return the blobs in the px of the frame that a camera shows by `view`; masks are resampled."""
        table, scale, linear = self.table.copy(), view.map.scale, view.map.matrix[:, :2]
        corners, sides = table["position"][:, ::-1], np.column_stack([table["columns"], table["rows"]])
        boxes = np.hstack([corners, np.zeros_like(corners)]) + table["box_mean"]
        unsure = view.box_variances(boxes)
        boxes = view.map.boxes(boxes)
        patches = view.map.boxes(np.hstack([corners + sides * [0.5, 1.0], sides]))
        shapes = np.maximum(np.rint(patches[:, 2:]), 1.0)
        corners = patches[:, :2] - 0.5 * (patches[:, 2:] * [0, 1] + shapes)
        x, y, *lengths = table["origin"].T
        origins = view.map.boxes(np.column_stack([x + 0.5 * lengths[0], y + lengths[1], *lengths]))
        table["position"], table["velocity"] = corners[:, ::-1], table["velocity"] @ linear[::-1, ::-1].T
        table["covariance"] *= scale.prod()
        table["covariance"][:, 0, 0] += unsure[:, :WIDTH].mean(axis=1)
        table["size"] *= scale[::-1]
        table["box_mean"] = boxes - np.hstack([corners, np.zeros_like(corners)])
        table["box_variance"] *= np.tile(scale**2, 2)
        table["box_variance"][:, WIDTH:] += unsure[:, WIDTH:]
        table["origin"] = origins - origins[:, [WIDTH, HEIGHT, WIDTH, WIDTH]] * [0.5, 1.0, 0, 0]
        moved = self.with_table(table)
        if (shapes == sides).all():
            return moved
        return self.of(
            [blob.resampled(shape) for blob, shape in zip(moved, shapes.astype(int).tolist(), strict=True)],
            self.channels,
        )

    def concatenate(self, blobs: Sequence[Blob]) -> Self:
        """Return the blobs followed by new ones."""
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


def union(boxes: Numbers) -> Numbers:
    """Return the box that holds all boxes `(n, 4)` x, y, width, height."""
    first, end = boxes[:, :2].min(axis=0), (boxes[:, :2] + boxes[:, 2:]).max(axis=0)
    return np.concatenate([first, end - first])


@short_repr
@dataclass(frozen=True, eq=False)
class BlobState:
    """State of all objects of a scene."""

    blobs: Blobs
    born: CountFrom0  # how many there have been
    size: Annotated[tuple[int, int], SizesOf("height", "width")]  # px of the picture
    elapsed: NotNegative  # s since the last frame with an image
    confirmation_time: NotNegative  # s for which an object must have been seen before it is reported
    left_behind: LeftBehind  # by objects that have moved on
    detecting: bool = False  # whether a detector has run, which decides what is reported
    # that a detector may have found: not reported, and without pixels
    candidates: Blobs = field(default_factory=lambda: Blobs.none(3))

    def require_fit(self) -> None:
        """Raise a `ValueError` if what objects have left behind is of another picture."""
        expected, got = (*self.size, self.blobs.channels), self.left_behind.shown.shape
        if got != expected:
            raise ValueError(f"left_behind: got {got} px and channels, expected {expected}")

    def tracks(self) -> list[Track]:
        """Return the objects that are sure enough to be reported, by identity."""
        blobs, table = self.blobs, self.blobs.table
        if not len(table):
            return []
        found = table["detected"] != 0
        sure = blobs.are_likely if self.detecting else table["seen"] >= self.confirmation_time
        parts: dict[int, list[int]] = {}
        for k in np.flatnonzero(sure & (found | ~blobs.are_fragments)).tolist():
            parts.setdefault(int(table["whole"][k]), []).append(k)
        confidence = np.where(found, blobs.existence_probability, table["confidence"])
        shown = ((table["unseen"] == 0) & (self.elapsed == 0)) | (found & (table["unfound"] == 0))
        return [_track(identity, parts[identity], blobs, confidence, shown) for identity in sorted(parts)]


def _track(identity: int, parts: list[int], blobs: Blobs, confidence: Numbers, shown: Mask) -> Track:
    """Track of an object with these parts."""
    largest = parts[0] if len(parts) == 1 else parts[int(np.argmax(blobs.table["mass"][parts]))]
    boxes = blobs.reported_boxes[parts]
    x, y, width, height = (boxes[0] if len(parts) == 1 else union(boxes)).tolist()
    speed_y, speed_x = blobs.table["velocity"][largest].tolist()
    covariance = centre_covariance(blobs.reported_variances[largest])
    return Track(
        identity,
        (x, y, width, height),
        float(confidence[largest]),
        (speed_x, speed_y),
        bool(shown[parts].any()),
        covariance,
    )


def box_densities(identities: ArrayLike, boxes: ArrayLike) -> GaussianMessage:
    """Return the boxes of objects, `(n, 4)` px, with usual errors as a message to `ObjectBoxes`."""
    x, y, width, height = np.asarray(boxes, np.float64).T
    deviations = np.stack([0.05 * width, 0.03 * height, 0.15 * width, 0.08 * height], axis=1) + 1
    return GaussianMessage.from_moments(
        np.asarray(identities, np.int64),
        np.stack([x + 0.5 * width, y + height, width, height], axis=1),
        deviations[:, :, None] ** 2 * np.eye(4),
    )


def take_crumbs(mask: Map) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Remove spots that are apart and under a tenth of the largest; return labels of spots, and of these."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats((mask > COVERED).astype(np.uint8), connectivity=8)
    areas = boxes[:, cv2.CC_STAT_AREA]
    is_crumb = areas < CRUMB * areas[1:].max(initial=0)
    is_crumb[0] = False
    mask[is_crumb[labels]] = 0
    return np.asarray(labels), np.flatnonzero(is_crumb)


def likely_size(mask: Map) -> Numbers:
    """Return height and width px of what a mask likely covers, at least 1."""
    shape = measured(mask)
    return np.array([max(shape["bottom"] - shape["top"], 1.0), max(shape["right"] - shape["left"], 1.0)])


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


def front_to_back(blobs: Blobs) -> Blobs:
    """Return the blobs ordered from front to back: what stands lower in the picture is nearer."""
    return blobs.select(np.lexsort((blobs.table["identity"], -blobs.feet)))


def layers_of(blobs: Blobs, outliers: float, strength: float, ghost_threshold: float) -> LayerSheet:
    """Return blobs, front to back, as layers; a ghost says that there is no object, nor beside it."""
    known, table = blobs.table, np.empty(len(blobs), LAYER)
    table["top"], table["left"] = np.floor(known["position"] + 0.5).T
    for name in ("rows", "columns", "start", "coloured", "colour_variance"):
        table[name] = known[name]
    table["log_ratio"] = log_density_ratio(blobs.channels, known["colour_variance"])
    table["outliers"], table["strength"] = outliers, strength
    table["ghost"] = blobs.ghost_evidence >= ghost_threshold
    masks = blobs.masks
    for k in np.flatnonzero(table["ghost"]).tolist():
        shape = _around(blobs[k].mask)
        table["start"][k] = len(masks)
        masks = np.concatenate([masks, shape.reshape(-1)])
    return LayerSheet(table, Pools(masks, blobs.colours), blobs.channels)


def _around(mask: Map) -> Map:
    return np.asarray(cv2.dilate((mask > 0.25).astype(np.float32), np.ones((5, 5), np.uint8)), np.float32)
