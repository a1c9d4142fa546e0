"""Blob tracker as a chain: moving objects with their place, velocity, soft mask and colours.

The RSMCM paper's high-level chain (§4.2): first-order linear dynamics, appearance, and a rendering of every
object into the pixels. It is registered with what the background's chain and the image say of the pixels,
then speaks to them at its registered place: a place shared by all its pixels is what one pixel cannot know.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Any, overload

import cv2
import numpy as np
from numpy.typing import NDArray

from ..inference.core.protocols import Cavity, Incoming, Port
from ..models.background.layers import Layer, LayerStack, log_density_ratio
from ..models.background.pixel_labels import PixelLabels, PixelMessage
from ..models.core.frame import Frame
from ..models.core.gaussian_message import GaussianMessage
from ..models.core.short_repr import short_repr
from ..models.objects.kernels.blobs import (
    UNKNOWN_COLOUR,
    count_foreground,
    cover,
    density_without,
    gather,
    learn,
    outline_contrast,
    search,
)
from ..models.objects.kernels.masks import MaskShape, clear_blocks, fade_beyond, shape_of
from ..models.objects.object_boxes import HEIGHT, WIDTH, ObjectBoxes

Map = NDArray[np.float32]
Pair = NDArray[np.float64]

POSITIVE = (
    "smallest", "mask_time", "colour_time", "spread", "strength", "temper", "acceleration", "first_speed",
    "patience", "hidden_patience", "confirmed_hits", "ghost_evidence", "parting_time", "size_time",
)  # fmt: skip
"""Parameters of `BlobTracker` that must be more than 0."""

MARGIN = 6
"""px of empty border in a blob's patch, into which its mask can grow."""

THINNEST = 0.08
"""Area over squared length below which a spot is a line (a rope, an edge that shakes) and no object."""

GROWTH = 1.3
"""How far beyond its usual size a mask may reach."""

BENEFIT_OF_DOUBT = 0.6
"""What the mask of a still blob keeps of pixels that fit its colours as well as the background's."""

RENDERING_NOISE = 0.05
"""px^2 per frame, of rendering a blob at whole pixels."""

SWEEP = 8
"""Every how many looks a mask is freed of crumbs."""

FRESH = 10
"""Frames seen, below which a blob may still be a part of another."""


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
        frame leaves it as it was.
    velocity
        px/s to the right and down.
    """

    identity: int
    box: tuple[float, float, float, float]
    confidence: float
    velocity: tuple[float, float]


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
        `(channels, height, width)` float32 planes.
    spread
        squared grey levels: variance of its colours about `appearance`.
    hits
        frames in which it was seen.
    unseen, still
        s since it was last seen, and for which it has not moved.
    confidence
        share of its visible part that was seen in the last frame.
    ghost_evidence
        nats, how much more of its outline was found in the background's picture than in the image.
    parting
        s for which its mask has had a waist between two upright parts.
    size
        `(2,)` px, its usual height and width.
    """

    identity: int
    position: Pair
    velocity: Pair
    covariance: Pair
    mask: Map
    appearance: Map
    spread: float
    hits: int
    unseen: float
    still: float
    confidence: float
    ghost_evidence: float
    parting: float
    size: Pair

    @cached_property
    def corner(self) -> tuple[int, int]:
        """Top and left px of the patch, as it is rendered."""
        return math.floor(self.position[0] + 0.5), math.floor(self.position[1] + 0.5)

    @cached_property
    def shape(self) -> MaskShape:
        """Measures of the mask."""
        return shape_of(self.mask)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """x, y, width, height px of what the mask likely covers, or else of its patch."""
        top, left, bottom, right = self.shape[1:5]
        if bottom == 0 or right == 0:
            (top, left), (bottom, right) = (0, 0), self.mask.shape
        y, x = self.position.tolist()
        return x + left, y + top, float(right - left), float(bottom - top)

    @property
    def foot(self) -> float:
        """px, the lowest row: what stands lower in the picture is nearer."""
        return self.box[1] + self.box[3]

    @property
    def length(self) -> float:
        """px, the longer side of the box."""
        return max(self.box[2:])

    def changed(self, **values: Any) -> "Blob":
        """Like `dataclasses.replace`, but what was measured of a mask that stays is kept."""
        kept = {
            name: value for name, value in self.__dict__.items() if name not in ("corner", "shape", "box")
        }
        blob: Blob = object.__new__(Blob)
        blob.__dict__.update(kept | values)
        if "mask" not in values and "shape" in self.__dict__:
            blob.__dict__["shape"] = self.shape
        return blob


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
        s since the last look.
    confirmed_hits
        frames in which an object must have been seen before it is reported.
    """

    blobs: tuple[Blob, ...]
    born: int
    size: tuple[int, int]
    elapsed: float
    confirmed_hits: int

    def tracks(self) -> list[Track]:
        """Objects that are sure enough to be reported, by identity."""
        found = [blob for blob in self.blobs if blob.hits >= self.confirmed_hits]
        return [
            Track(
                blob.identity, blob.box, blob.confidence, (float(blob.velocity[1]), float(blob.velocity[0]))
            )
            for blob in sorted(found, key=lambda blob: blob.identity)
        ]


@short_repr
@dataclass(frozen=True)
class BlobTracker:
    """Tracker of any number of blobs.

    Lengths that should grow with the picture are shares of its area or of the blob's own size.

    Parameters
    ----------
    smallest
        share of the picture's area below which a spot is no object.
    mask_time, colour_time
        s in which a mask and its colours follow what is seen.
    spread
        squared grey levels: variance of a new blob's colours about the remembered ones, at most.
    outliers
        share of an object's pixels that look otherwise.
    strength
        how much likelier a known object is in front of the background than an unknown one.
    temper
        how many independent looks one pixel of a registration is worth.
    acceleration
        blob lengths per s^2, of the random force on a blob.
    first_speed
        blob lengths per s, standard deviation of a new blob's velocity.
    patience, hidden_patience
        s for which a blob that should be visible, or is hidden by another, may stay unseen.
    confirmed_hits
        frames in which an object must have been seen before it is reported.
    ghost_evidence
        nats from which on a blob is taken for a ghost: log ratio of the contrast across its outline in the
        background's picture and in the image, less 0.25 a frame, summed over frames and never below 0.
    parting_time
        s for which a blob's mask must have had a waist before it becomes two.
    size_time
        s in which a blob's usual size follows its box; its mask does not reach much further.
    """

    smallest: float = 0.0003
    mask_time: float = 0.4
    colour_time: float = 0.4
    spread: float = 300.0
    outliers: float = 0.1
    strength: float = 10.0
    temper: float = 0.15
    acceleration: float = 2.0
    first_speed: float = 2.0
    patience: float = 0.6
    hidden_patience: float = 3.0
    confirmed_hits: int = 5
    ghost_evidence: float = 2.5
    parting_time: float = 0.4
    size_time: float = 2.0
    name: str = "blobs"

    ports = (Port(PixelLabels, Cavity.OTHERS), Port(ObjectBoxes, optional=True))

    def __post_init__(self) -> None:
        for name in POSITIVE:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, expected more than 0")
        if not 0 < self.outliers < 1:
            raise ValueError(f"outliers: got {self.outliers}, expected a share between 0 and 1")

    def initial(self, frame: Frame) -> BlobState:
        """No objects: what is there from the first frame on is background until it moves."""
        if frame.image is None:
            raise ValueError(f"frame {frame.number}: got no image, expected one to start from")
        height, width = frame.image.shape[:2]
        return BlobState((), 0, (height, width), 0.0, self.confirmed_hits)

    def predict(self, state: BlobState, dt: float) -> BlobState:
        """First-order dynamics: velocity stays, but for a random force."""
        blobs = tuple(self._moved(blob, dt) for blob in state.blobs)
        return replace(state, blobs=blobs, elapsed=state.elapsed + dt)

    @overload
    def message(self, state: BlobState, feature: PixelLabels, incoming: Incoming) -> PixelMessage: ...
    @overload
    def message(self, state: BlobState, feature: ObjectBoxes, incoming: Incoming) -> GaussianMessage: ...
    def message(
        self, state: BlobState, feature: PixelLabels | ObjectBoxes, incoming: Incoming
    ) -> PixelMessage | GaussianMessage:
        """What objects say to a feature (mu_{S -> F}).

        To pixels: where they cover them and with which colours, front to back. To boxes: where they stand and
        how large they look, of those that were well seen in the last frame.
        """
        others = incoming[PixelLabels]
        blobs, layers = incoming.once(self._registered, state, others)
        if isinstance(feature, PixelLabels):
            return PixelMessage(layers=layers)
        shown = [blob for blob in blobs if blob.confidence > 0.5 and blob.hits >= FRESH]
        if others.image is None or not shown:
            return feature.uniform()
        x, y, width, height = np.array([blob.box for blob in shown]).T
        deviations = np.stack(
            [0.05 * width + 1, 0.03 * height + 1, 0.15 * width + 1, 0.08 * height + 1], axis=1
        )
        return GaussianMessage.from_moments(
            [blob.identity for blob in shown],
            np.stack([x + 0.5 * width, y + height, width, height], axis=1),
            deviations[:, :, None] ** 2 * np.eye(4),
        )

    def update(self, state: BlobState, incoming: Incoming) -> BlobState:
        """Objects after the frame: registered, learned from, born and ended."""
        others = incoming[PixelLabels]
        if others.image is None or others.subtraction is None:
            return state
        blobs, layers = incoming.once(self._registered, state, others)
        boxes = incoming.get(ObjectBoxes)
        scene = _Scene(others, layers, boxes, state.elapsed)
        learned = [self._learned(blob, blobs[:rank], scene) for rank, blob in enumerate(blobs)]
        kept = [blob for rank, blob in enumerate(learned) if self._lives(blob, blobs[:rank], scene)]
        numbers = count(state.born + 1)
        kept = self._merged([part for blob in kept for part in self._parted(blob, numbers, scene)])
        kept += self._newborn(kept, numbers, scene)
        return replace(state, blobs=tuple(kept), born=next(numbers) - 1, elapsed=0.0)

    def _moved(self, blob: Blob, dt: float) -> Blob:
        (place, both), (_, speed) = blob.covariance.tolist()
        push = self.acceleration * blob.length * dt
        place += 2 * dt * both + dt * dt * speed + 0.25 * (push * dt) ** 2 + RENDERING_NOISE
        both += dt * speed + 0.5 * push * push * dt
        return blob.changed(
            position=blob.position + dt * blob.velocity,
            covariance=np.array([[place, both], [both, speed + push * push]]),
        )

    def _registered(self, state: BlobState, others: PixelMessage) -> tuple[list[Blob], LayerStack]:
        """Blobs front to back at the place where this frame shows them, and their layers."""
        blobs = sorted(state.blobs, key=lambda blob: (-blob.foot, blob.identity))
        if others.image is not None and others.subtraction is not None:
            placed: list[Blob] = []
            for blob in blobs:
                placed.append(self._placed(blob, placed, others))
            blobs = placed
        return blobs, LayerStack([self._layer(blob) for blob in blobs])

    def _layer(self, blob: Blob) -> Layer:
        top, left = blob.corner
        if blob.ghost_evidence >= self.ghost_evidence:
            shape = cv2.dilate((blob.mask > 0.25).astype(np.float32), np.ones((5, 5), np.uint8))
            return Layer(top, left, np.asarray(shape, np.float32), None, ghost=True)
        return Layer(top, left, blob.mask, blob.appearance, blob.spread, self.outliers, self.strength)

    def _placed(self, blob: Blob, in_front: Sequence[Blob], others: PixelMessage) -> Blob:
        """Register a blob with the pixels that nothing in front covers; update place and velocity."""
        top, left = blob.corner
        (place, both), (_, speed) = blob.covariance.tolist()
        reach = int(min(max(2.5 * math.sqrt(place) + 1, 2), max(6, min(0.35 * blob.length, 24))))
        window = _Window(others, top - reach, left - reach, blob.mask.shape, reach)
        window.hide(in_front)
        assert others.background is not None
        down, right, variance_y, variance_x = search(
            reach, blob.position[0] - top, blob.position[1] - left, 1 / max(place, 0.25),
            np.float32(self.temper), max(1, blob.mask.size // 1500), window.planes,
            density_without(window.odds, np.float32(others.background.prior)), window.free, blob.mask,
            blob.appearance, *self._colour_model(blob),
        )  # fmt: skip
        variance = min(max(variance_y, variance_x, 0.25), 100.0)
        gain, speed_gain = place / (place + variance), both / (place + variance)
        innovation = np.array([top + down, left + right]) - blob.position
        after = [[(1 - gain) * place, (1 - gain) * both], [(1 - gain) * both, speed - speed_gain * both]]
        return blob.changed(
            position=blob.position + gain * innovation,
            velocity=blob.velocity + speed_gain * innovation,
            covariance=np.array(after),
        )

    def _colour_model(self, blob: Blob) -> tuple[np.float32, np.float32, np.float32]:
        ratio = log_density_ratio(blob.appearance.shape[0], blob.spread)
        return np.float32(0.5 / blob.spread), np.float32(ratio), np.float32(self.outliers)

    def _learned(self, blob: Blob, in_front: Sequence[Blob], scene: "_Scene") -> Blob:
        """Mask and colours after the frame, and how much of the blob was seen."""
        if blob.ghost_evidence >= self.ghost_evidence:
            return blob.changed(unseen=math.inf)
        blob = _fitted(blob)
        window = _Window(scene.others, *blob.corner, blob.mask.shape)
        window.hide(in_front)
        mask, appearance = np.empty_like(blob.mask), np.empty_like(blob.appearance)
        explained = scene.explained(*blob.corner, blob.mask.shape)
        total, visible, seen, variance = learn(
            window.planes, window.odds, window.free, explained, blob.mask, blob.appearance,
            *self._colour_model(blob), np.float32(self.strength),
            np.float32(1 - np.exp(-scene.elapsed / self.mask_time)),
            np.float32(1 - np.exp(-scene.elapsed / self.colour_time)),
            np.float32(BENEFIT_OF_DOUBT if blob.still > 0.2 else 0.0), mask, appearance,
        )  # fmt: skip
        entered = scene.entered(blob)
        if entered is not None:
            # it has never been looked at before: learned at once, as of a newborn
            new = np.minimum(0.9, entered * window.free / (explained * (1 + np.exp(window.odds))))
            taken = (new > 0.2) & (new > mask)
            mask[taken] = new[taken]
            appearance[:, taken] = window.planes[:, taken]
        elif blob.hits >= FRESH:
            fade_beyond(mask, *(GROWTH * scene.expected_size(blob)))
        confidence = seen / max(visible, 1e-6)
        if visible <= 0.3 * total or confidence <= 0.35:
            return blob.changed(
                mask=mask,
                appearance=appearance,
                unseen=blob.unseen + scene.elapsed,
                still=0.0,
                confidence=0.0,
            )
        speed = math.hypot(*blob.velocity)
        follow = 1 - math.exp(-scene.elapsed / self.colour_time)
        spread = blob.spread + follow * (2 * variance - blob.spread)
        grown = 1 - math.exp(-scene.elapsed / (self.mask_time if blob.hits < FRESH else self.size_time))
        size = blob.size + grown * (np.array(blob.box[:1:-1]) - blob.size)
        return blob.changed(
            mask=mask,
            appearance=appearance,
            size=size if entered is None else np.maximum(size, _likely_size(mask)),
            spread=min(max(spread, 0.2 * self.spread), self.spread),
            hits=blob.hits + 1,
            unseen=0.0,
            still=blob.still + scene.elapsed if speed < max(2.0, 0.06 * blob.length) else 0.0,
            confidence=confidence,
            ghost_evidence=self._ghostly(blob, mask, window, scene) if speed < blob.length else 0.0,
        )

    def _ghostly(self, blob: Blob, mask: Map, window: "_Window", scene: "_Scene") -> float:
        """Evidence that the outline is an edge of the remembered background instead of one of the image."""
        picture = scene.picture(*blob.corner, mask.shape)
        in_image, in_picture, length = outline_contrast(window.planes, picture, window.free, mask, 2)
        if length < 8:
            return blob.ghost_evidence
        return max(blob.ghost_evidence + math.log((in_picture + 3) / (in_image + 3)) - 0.25, 0.0)

    def _least_area(self, scene: "_Scene") -> float:
        """px of the smallest object."""
        return self.smallest * scene.size[0] * scene.size[1]

    def _lives(self, blob: Blob, in_front: Sequence[Blob], scene: "_Scene") -> bool:
        mass = blob.shape.mass
        thin = mass < THINNEST * blob.length**2 * (1.0 if blob.hits < FRESH else 0.5)
        if thin or mass < self._least_area(scene):
            return False
        window = scene.inside(blob)
        if float(blob.mask[window].sum()) < 0.1 * mass:
            return False
        if blob.hits < self.confirmed_hits:
            return blob.unseen == 0.0
        hidden = blob.unseen > 0 and _hidden(blob, in_front)
        return blob.unseen < (self.hidden_patience if hidden else self.patience)

    def _parted(self, blob: Blob, numbers: Iterator[int], scene: "_Scene") -> list[Blob]:
        """A blob that has had a waist between two heads for a while is two; crumbs are swept away."""
        if blob.unseen > 0:
            return [blob]
        shape = blob.shape
        parting = blob.parting + scene.elapsed if shape.waist_depth < 0.5 else 0.0
        left, right = shape.mass_left, shape.mass - shape.mass_left
        smallest = self._least_area(scene)
        blob = blob.changed(parting=parting)
        if parting < self.parting_time or min(left, right) < max(smallest, 0.25 * max(left, right)):
            return [blob if blob.hits % SWEEP else blob.changed(mask=_without_crumbs(blob.mask))]
        halves = np.zeros((2, *blob.mask.shape), np.float32)
        halves[0, :, : shape.waist] = blob.mask[:, : shape.waist]
        halves[1, :, shape.waist :] = blob.mask[:, shape.waist :]
        larger, smaller = halves if left >= right else halves[::-1]
        blob = blob.changed(parting=0.0, still=0.0, ghost_evidence=0.0)
        return [
            blob.changed(mask=larger, size=_likely_size(larger)),
            blob.changed(mask=smaller, size=_likely_size(smaller), identity=next(numbers)),
        ]

    def _merged(self, blobs: list[Blob]) -> list[Blob]:
        """Pieces of one object become one blob again (see `_pieces`), under the identity seen most."""
        result: list[Blob] = []
        for blob in sorted(blobs, key=lambda blob: (-blob.hits, blob.identity)):
            other = next((k for k, kept in enumerate(result) if _pieces(kept, blob)), None)
            if other is None:
                result.append(blob)
            else:
                result[other] = _joined(result[other], blob)
        return result

    def _newborn(self, blobs: Sequence[Blob], numbers: Iterator[int], scene: "_Scene") -> Iterator[Blob]:
        """Foreground that no blob explains."""
        smallest = self._least_area(scene)
        for top, left, bottom, right, area in scene.unexplained(blobs):
            if area < max(smallest, THINNEST * max(bottom - top, right - left) ** 2):
                continue
            top, left, bottom, right = top - MARGIN, left - MARGIN, bottom + MARGIN, right + MARGIN
            window = _Window(scene.others, top, left, (bottom - top, right - left))
            window.hide(blobs)
            mask = np.minimum(0.9, window.free / (1 + np.exp(window.odds))).astype(np.float32)
            if float(mask.sum()) < smallest:
                continue
            length = float(max(bottom - top, right - left) - 2 * MARGIN)
            yield Blob(
                identity=next(numbers),
                position=np.array([float(top), float(left)]),
                velocity=np.zeros(2),
                covariance=np.diag([1.0, (self.first_speed * length) ** 2]),
                mask=mask,
                appearance=np.where(mask > 0.2, window.planes, np.float32(UNKNOWN_COLOUR)),
                spread=self.spread,
                hits=1,
                unseen=0.0,
                still=0.0,
                confidence=1.0,
                ghost_evidence=0.0,
                parting=0.0,
                size=np.array([bottom - top - 2.0 * MARGIN, right - left - 2.0 * MARGIN]),
            )


class _Window:
    """What is known of the pixels in a box: planes, log odds of background, and what nothing else covers."""

    def __init__(
        self, others: PixelMessage, top: int, left: int, shape: tuple[int, int], border: int = 0
    ) -> None:
        assert others.image is not None
        assert others.subtraction is not None
        image = others.image if others.image.ndim == 3 else others.image[:, :, None]
        rows, columns = shape[0] + 2 * border, shape[1] + 2 * border
        self.top, self.left = top, left
        self.planes = np.empty((image.shape[2], rows, columns), np.float32)
        self.odds = np.empty((rows, columns), np.float32)
        self.free = np.empty((rows, columns), np.float32)
        log_odds = others.subtraction.pooled.reshape(image.shape[:2])
        gather(image, log_odds, top, left, self.planes, self.odds, self.free)

    def hide(self, blobs: Sequence[Blob]) -> None:
        """Take away what blobs cover."""
        _cover(self.free, self.top, self.left, blobs)


class _Scene:
    """A frame as blobs need it when they are updated."""

    def __init__(
        self, others: PixelMessage, layers: LayerStack, boxes: GaussianMessage | None, elapsed: float
    ) -> None:
        self.others = others
        self._expected: dict[int, tuple[Pair, Pair]] = {}
        if boxes is not None:
            sides = [HEIGHT, WIDTH]
            for identity, mean, covariance in zip(*boxes.moments, strict=True):
                self._expected[int(identity)] = (mean[sides], covariance.diagonal()[sides])
        self.size = others.size
        self.elapsed = elapsed
        self._regions = layers.regions(others.image, others.size)

    def expected_size(self, blob: Blob) -> Pair:
        """Usual height and width px of a blob, and what other chains expect of it, by their precisions."""
        if blob.identity not in self._expected:
            return blob.size
        expected, variance = self._expected[blob.identity]
        own, theirs = 1 / (0.15 * blob.size) ** 2, 1 / np.maximum(variance, 1.0)
        size: Pair = (own * blob.size + theirs * expected) / (own + theirs)
        return np.maximum(size, 0.5 * blob.size)

    def explained(self, top: int, left: int, shape: tuple[int, int]) -> Map:
        """What all layers together explain of the pixels in a box, 1 where there is none."""
        out = np.ones(shape, np.float32)
        for region in self._regions:
            _paste(out, top, left, region.explained, region.top, region.left)
        return out

    def picture(self, top: int, left: int, shape: tuple[int, int]) -> Map:
        """Planes of the remembered background in a box."""
        background = self.others.background
        assert background is not None
        planes = background.mean.reshape(-1, *self.size)
        out = np.zeros((len(planes), *shape), np.float32)
        for channel, plane in zip(out, planes, strict=True):
            _paste(channel, top, left, plane, 0, 0)
        return out

    def entered(self, blob: Blob) -> Map | None:
        """1 where a blob's patch has come into the picture since the last look; `None` if nowhere."""
        before = blob.changed(position=blob.position - self.elapsed * blob.velocity)
        if self.inside(before) == self.inside(blob):
            return None
        out = np.zeros(blob.mask.shape, np.float32)
        out[self.inside(blob)] = 1
        out[self.inside(before)] = 0
        return out

    def inside(self, blob: Blob) -> tuple[slice, slice]:
        """The part of a blob's patch that lies in the picture."""
        (top, left), (rows, columns) = blob.corner, blob.mask.shape
        return (
            slice(min(max(0, -top), rows), max(0, min(rows, self.size[0] - top))),
            slice(min(max(0, -left), columns), max(0, min(columns, self.size[1] - left))),
        )

    def unexplained(self, blobs: Sequence[Blob]) -> Iterator[tuple[int, int, int, int, int]]:
        """Top, left, bottom, right and area px of foreground spots that do not touch a blob."""
        height, width = self.size
        scale = max(1, round(max(height, width) / 192))
        assert self.others.subtraction is not None
        counts = np.empty((-(-height // scale), -(-width // scale)), np.int32)
        count_foreground(self.others.subtraction.pooled, width, scale, counts)
        for blob in blobs:
            clear_blocks(counts, *blob.corner, blob.mask, scale)
        spots = (counts * 4 >= scale * scale).astype(np.uint8)
        found, labels, boxes, _ = cv2.connectedComponentsWithStats(spots, connectivity=8)
        for label in range(1, found):
            x, y, columns, rows, _ = (int(value) for value in boxes[label])
            area = int(counts[labels == label].sum())
            yield scale * y, scale * x, scale * (y + rows), scale * (x + columns), area


def _cover(free: Map, top: int, left: int, blobs: Sequence[Blob]) -> None:
    """Take away from `free`, placed at `(top, left)`, what blobs cover."""
    rows, columns = free.shape
    for blob in blobs:
        down, right = blob.corner[0] - top, blob.corner[1] - left
        if -blob.mask.shape[0] < down < rows and -blob.mask.shape[1] < right < columns:
            cover(free, down, right, blob.mask)


def _hidden(blob: Blob, in_front: Sequence[Blob]) -> bool:
    """Whether others cover most of a blob."""
    free = np.ones(blob.mask.shape, np.float32)
    _cover(free, *blob.corner, in_front)
    return float((free * blob.mask).sum()) < 0.5 * float(blob.mask.sum())


def _likely_size(mask: Map) -> Pair:
    shape = shape_of(mask)
    return np.array([max(shape.bottom - shape.top, 1.0), max(shape.right - shape.left, 1.0)])


def _without_crumbs(mask: Map) -> Map:
    """The mask without spots that are apart from its main part and small."""
    found, labels, boxes, _ = cv2.connectedComponentsWithStats((mask > 0.3).astype(np.uint8), connectivity=8)
    if found <= 2:
        return mask
    areas = boxes[:, cv2.CC_STAT_AREA]
    crumb = areas < 0.1 * areas[1:].max()
    crumb[0] = False
    return np.where(crumb[labels], np.float32(0), mask)


def _paste(out: Map, top: int, left: int, source: Map, source_top: int, source_left: int) -> None:
    """Copy the common part of two placed arrays."""
    first_row, first_column = max(top, source_top), max(left, source_left)
    end_row = min(top + out.shape[0], source_top + source.shape[0])
    end_column = min(left + out.shape[1], source_left + source.shape[1])
    if first_row < end_row and first_column < end_column:
        out[first_row - top : end_row - top, first_column - left : end_column - left] = source[
            first_row - source_top : end_row - source_top,
            first_column - source_left : end_column - source_left,
        ]


def _fitted(blob: Blob) -> Blob:
    """The blob with a patch that leaves its mask room to grow, and not much more."""
    measured = blob.shape
    begin = np.array([measured.faint_top, measured.faint_left])
    end = np.array([measured.faint_bottom, measured.faint_right])
    room = [*begin, *(np.array(blob.mask.shape) - end)]
    if not end.all() or (min(room) >= MARGIN // 2 and max(room) <= 3 * MARGIN):
        return blob
    first, shape = begin - MARGIN, tuple(end - begin + 2 * MARGIN)
    mask = np.zeros(shape, np.float32)
    appearance = np.full((len(blob.appearance), *shape), UNKNOWN_COLOUR, np.float32)
    _paste(mask, int(first[0]), int(first[1]), blob.mask, 0, 0)
    for new, old in zip(appearance, blob.appearance, strict=True):
        _paste(new, int(first[0]), int(first[1]), old, 0, 0)
    return blob.changed(position=blob.position + first, mask=mask, appearance=appearance)


def _pieces(one: Blob, other: Blob) -> bool:
    """Whether two blobs, the second seen in no more frames, are parts of one object.

    What touches a blob right after it was born belongs to it if it is above, below or small, and the two
    together are not much larger than the larger (or the first is as new); so do blobs that have stood still
    above each other for a while, or that move alike above each other and make one upright body together.
    """
    x, y, width, height = one.box
    other_x, other_y, other_width, other_height = other.box
    gap_y = max(y, other_y) - min(y + height, other_y + other_height)
    gap_x = max(x, other_x) - min(x + width, other_x + other_width)
    if max(gap_x, gap_y) > 3:
        return False
    stacked = -gap_x > 0.7 * min(width, other_width)
    tall = max(y + height, other_y + other_height) - min(y, other_y)
    wide = max(x + width, other_x + other_width) - min(x, other_x)
    if other.hits >= FRESH:
        alike = math.hypot(*(one.velocity - other.velocity)) < 0.2 * tall
        one_body = -gap_y < 0.2 * min(height, other_height) and tall < 3.2 * wide and alike
        return stacked and (one_body or min(one.still, other.still) > 1.5)
    modest = tall < 1.6 * max(height, other_height) and wide < 1.6 * max(width, other_width)
    small = min(width * height, other_width * other_height) < 0.35 * max(
        width * height, other_width * other_height
    )
    return (stacked or small) and (one.hits < FRESH or modest)


def _joined(one: Blob, other: Blob) -> Blob:
    """One blob of two; it keeps the first one's identity and motion."""
    corners = np.array([one.corner, other.corner])
    ends = corners + np.array([one.mask.shape, other.mask.shape])
    first, shape = corners.min(axis=0), tuple(ends.max(axis=0) - corners.min(axis=0))
    mask = np.zeros(shape, np.float32)
    appearance = np.full((len(one.appearance), *shape), UNKNOWN_COLOUR, np.float32)
    for blob in (other, one):
        top, left = np.array(blob.corner) - first
        window = (slice(top, top + blob.mask.shape[0]), slice(left, left + blob.mask.shape[1]))
        better = blob.mask > mask[window]
        mask[window][better] = blob.mask[better]
        for new, old in zip(appearance, blob.appearance, strict=True):
            new[window][better] = old[better]
    return one.changed(
        position=one.position + (first - corners[0]),
        mask=mask,
        appearance=appearance,
        size=_likely_size(mask),
        hits=max(one.hits, other.hits),
    )
