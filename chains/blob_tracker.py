"""Blob tracker as a chain: moving objects with their place, velocity, soft mask and colours.

Of objects j, front to back, with place and velocity x_j, mask M_j and colours A_j:

    p(x_t | x_t-1) = N(x_t; F(dt) x_t-1, Q(dt)), constant velocity but for white acceleration; M_j, A_j stay
    mu_{S -> F_k}(B_k = 1) = prod_j (1 - M_jk)
    mu_{S -> F_k}(B_k = 0, L_k) = 1 + sum_j strength M_jk p(L_k | A_jk) prod_{i<j} (1 - M_ik), in units of U
    mu_{S -> boxes}(b_j) = N(b_j; box of M_j at x_j, a share of its size)

The RSMCM paper's high-level chain (§4.2): first-order linear dynamics, appearance, and a rendering of every
object into the pixels. It is registered with what the background's chain and the image say of the pixels,
then speaks to them at its registered place: a place shared by all its pixels is what one pixel cannot know.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import overload

import numpy as np

from ..inference.core.protocols import Cavity, Incoming, Port
from ..inference.objects import detections
from ..inference.objects.blob_geometry import (
    FRESH,
    THINNEST,
    fitted,
    is_hidden,
    likely_size,
    without_crumbs,
)
from ..inference.objects.blob_scene import BlobScene, cut_out
from ..inference.objects.blobs import Blob, BlobState, around
from ..inference.objects.ghosts import ghost_layer, inherited, weighed
from ..inference.objects.groups import alone, fragment_time, halves, merged, parting_column, with_parts
from ..inference.objects.registration import front_to_back, registered
from ..models.background.layers import Layer, LayerStack
from ..models.background.pixel_labels import PixelLabels, PixelMessage
from ..models.core.frame import Frame
from ..models.core.short_repr import short_repr
from ..models.objects.box_message import BoxMessage
from ..models.objects.kernels.blobs import learn
from ..models.objects.kernels.masks import fade_beyond
from ..models.objects.object_boxes import ObjectBoxes

POSITIVE = (
    "smallest", "mask_time", "colour_time", "spread", "strength", "temper", "acceleration", "first_speed",
    "patience", "hidden_patience", "confirmed_time", "ghost_evidence", "parting_time", "size_time",
)  # fmt: skip
"""Parameters of `BlobTracker` that must be more than 0."""

GROWTH = 1.3
"""How far beyond its usual size a mask may reach."""

BENEFIT_OF_DOUBT = 0.6
"""What the mask of a still blob keeps of pixels that fit its colours as well as the background's."""

SWEEP = 0.8
"""s after which a mask is freed of crumbs again."""

FADING = 0.06
"""s, time constant with which a mask fades where it reaches too far."""


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
        how many independent observations one pixel of a registration is worth.
    acceleration
        blob lengths/s^2, standard deviation of what moves a blob out of its straight way; it lasts half a
        second.
    first_speed
        blob lengths/s, standard deviation of a new blob's velocity.
    patience, hidden_patience
        s for which a blob that should be visible, or is hidden by another, may stay unseen.
    confirmed_time
        s for which an object must have been seen before it is reported, in every frame.
    ghost_evidence
        nats from which on a blob is taken for a ghost: log ratio of an outline that is an edge of the
        background's picture and one that is an edge of the image (see `inference.objects.ghosts`).
    parting_time
        s for which a blob must have had a waist, or the width of two people, before it becomes two.
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
    acceleration: float = 0.9
    first_speed: float = 2.0
    patience: float = 0.6
    hidden_patience: float = 3.0
    confirmed_time: float = 0.35
    ghost_evidence: float = 5.0
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
        return BlobState((), 0, frame.image.shape[:2], 0.0, self.confirmed_time)

    def predict(self, state: BlobState, dt: float) -> BlobState:
        """First-order dynamics: velocity stays, but for a random force."""
        blobs = detections.moved(state.blobs, dt, self.acceleration, state.detecting)
        return replace(state, blobs=blobs, elapsed=state.elapsed + dt)

    @overload
    def message(self, state: BlobState, feature: PixelLabels, incoming: Incoming) -> PixelMessage: ...
    @overload
    def message(self, state: BlobState, feature: ObjectBoxes, incoming: Incoming) -> BoxMessage: ...
    def message(
        self, state: BlobState, feature: PixelLabels | ObjectBoxes, incoming: Incoming
    ) -> PixelMessage | BoxMessage:
        """What objects say to a feature (mu_{S -> F}).

        To pixels: where they cover them and with which colours, front to back. To boxes: where they stand and
        how large they look, of those that were well seen in the last frame.
        """
        if isinstance(feature, PixelLabels):
            return PixelMessage(layers=self._placed(state, incoming)[2])
        pixels = incoming[PixelLabels]
        blobs, _ = incoming.once(self._registered, state, pixels)
        return detections.said(alone(blobs), state.detecting, pixels.image is not None)

    def update(self, state: BlobState, incoming: Incoming) -> BlobState:
        """Objects after the frame: registered, learned from, born and ended."""
        pixels, boxes = incoming[PixelLabels], incoming.get(ObjectBoxes)
        blobs, newborn, layers = self._placed(state, incoming)
        if boxes is not None and boxes.association is not None:
            blobs = [blob for blob in blobs if detections.is_kept(blob, state.size)]
            state = replace(state, blobs=(*blobs, *newborn), born=state.born + len(newborn), detecting=True)
        if pixels.subtraction is None:
            return state
        scene = BlobScene(pixels, layers, boxes, state.elapsed)
        learned = [self._learned(blob, blobs[:rank], scene) for rank, blob in enumerate(blobs)]
        kept = [blob for rank, blob in enumerate(learned) if self._lives(blob, blobs[:rank], scene)]
        numbers = count(state.born + 1)
        kept += [scene.coloured(blob) for blob in newborn]
        kept = merged([part for blob in kept for part in self._parted(blob, numbers, scene)])
        kept = with_parts(kept, scene.newcomers)
        kept = [blob.changed(fragment_time=fragment_time(blob, scene)) for blob in kept]
        for corner, mask, planes in scene.unexplained(kept, self._least_area(scene)):
            new = Blob.newborn(next(numbers), corner, mask, planes, self.first_speed, self.spread)
            kept.append(new.changed(past_views=inherited(new, kept)))
        return replace(state, blobs=tuple(kept), born=next(numbers) - 1, elapsed=0.0)

    def _placed(self, state: BlobState, incoming: Incoming) -> tuple[list[Blob], list[Blob], LayerStack]:
        """Blobs front to back where pixels and detections show them, those that are new, and the layers."""
        pixels, boxes = incoming[PixelLabels], incoming.get(ObjectBoxes)
        registered = incoming.once(self._registered, state, pixels)
        if boxes is None or boxes.association is None:
            return registered[0], [], registered[1]
        return incoming.once(self._detected, state, pixels, boxes, registered)

    def _detected(
        self, state: BlobState, pixels: PixelMessage, boxes: BoxMessage, found: tuple[list[Blob], LayerStack]
    ) -> tuple[list[Blob], list[Blob], LayerStack]:
        blobs = front_to_back(detections.corrected(found[0], boxes))
        # born where there is no image, it is of any colour until there is one
        channels = 0 if pixels.image is None else 1 if pixels.image.ndim == 2 else 3
        new = [
            detections.newborn(number, boxes, k, channels)
            for number, k in enumerate(detections.unexplained(boxes, state.size), state.born + 1)
        ]
        blobs = [blob for blob in blobs if not detections.is_part(blob, new)]
        return blobs, new, LayerStack([self._layer(blob) for blob in front_to_back([*blobs, *new])])

    def _registered(self, state: BlobState, pixels: PixelMessage) -> tuple[list[Blob], LayerStack]:
        """Blobs front to back at the place where this frame shows them, and their layers."""
        blobs = front_to_back(state.blobs)
        if pixels.subtraction is not None:
            blobs = registered(blobs, pixels, self.outliers, self.temper, state.elapsed)
        return blobs, LayerStack([self._layer(blob) for blob in blobs])

    def _layer(self, blob: Blob) -> Layer:
        if blob.ghost_evidence >= self.ghost_evidence:
            return ghost_layer(blob)
        return Layer(*blob.corner, blob.mask, blob.appearance, blob.spread, self.outliers, self.strength)

    def _learned(self, blob: Blob, in_front: Sequence[Blob], scene: BlobScene) -> Blob:
        """Mask and colours after the frame, and how much of the blob was seen."""
        if blob.ghost_evidence >= self.ghost_evidence:
            return blob.changed(unseen=math.inf)
        blob = fitted(blob if len(blob.appearance) else scene.coloured(blob))
        patch = cut_out(scene.pixels, *blob.corner, blob.mask.shape, in_front)
        mask, appearance = np.empty_like(blob.mask), np.empty_like(blob.appearance)
        explained = scene.explained(*blob.corner, blob.mask.shape)
        total, visible, seen, variance = learn(
            patch, explained, blob.sprite(self.outliers), np.float32(self.strength),
            np.float32(1 - np.exp(-scene.elapsed / self.mask_time)),
            np.float32(1 - np.exp(-scene.elapsed / self.colour_time)),
            np.float32(BENEFIT_OF_DOUBT if blob.still > 0.2 else 0.0), mask, appearance,
        )  # fmt: skip
        entered = scene.entered(blob)
        if entered is not None:
            # it has never been seen before: learned at once, as of a newborn
            new = np.minimum(0.9, entered * patch.free / (explained * (1 + np.exp(patch.log_odds))))
            taken = (new > 0.2) & (new > mask)
            mask[taken] = new[taken]
            appearance[:, taken] = patch.planes[:, taken]
        elif blob.seen >= FRESH:
            kept = np.float32(math.exp(-scene.elapsed / FADING))
            fade_beyond(mask, *(GROWTH * scene.expected_size(blob)), kept)
        confidence = seen / max(visible, 1e-6)
        if visible <= 0.3 * total or confidence <= 0.35:
            unseen = blob.unseen + scene.elapsed
            return blob.changed(mask=mask, appearance=appearance, unseen=unseen, still=0.0, confidence=0.0)
        speed = math.hypot(*blob.velocity)
        follow = 1 - math.exp(-scene.elapsed / self.colour_time)
        spread = blob.spread + follow * (2 * variance - blob.spread)
        grown = 1 - math.exp(-scene.elapsed / (self.mask_time if blob.seen < FRESH else self.size_time))
        size = blob.size + grown * (np.array(blob.box[:1:-1]) - blob.size)
        view, past_views = weighed(blob, mask, patch, scene, self.temper)
        return blob.changed(
            mask=mask,
            appearance=appearance,
            size=size if entered is None else np.maximum(size, likely_size(mask)),
            spread=min(max(spread, 0.2 * self.spread), self.spread),
            seen=blob.seen + scene.elapsed,
            unseen=0.0,
            still=blob.still + scene.elapsed if speed < max(2.0, 0.06 * blob.length) else 0.0,
            confidence=confidence,
            view=view,
            past_views=past_views,
            origin=blob.origin if blob.seen >= FRESH else around(blob.origin, blob.box),
        )

    def _least_area(self, scene: BlobScene) -> float:
        """px of the smallest object."""
        return self.smallest * scene.size[0] * scene.size[1]

    def _lives(self, blob: Blob, in_front: Sequence[Blob], scene: BlobScene) -> bool:
        if blob.detected is not None:
            return True
        mass = blob.shape.mass
        thin = mass < THINNEST * blob.length**2 * (1.0 if blob.seen < FRESH else 0.5)
        outside = float(blob.mask[scene.inside(blob)].sum()) < 0.1 * mass
        if thin or outside or mass < self._least_area(scene):
            return False
        if blob.seen < self.confirmed_time:
            return blob.unseen == 0.0
        hidden = blob.unseen > 0 and is_hidden(blob, in_front)
        return blob.unseen < (self.hidden_patience if hidden else self.patience)

    def _parted(self, blob: Blob, numbers: Iterator[int], scene: BlobScene) -> list[Blob]:
        """A blob that has had a waist or the width of two for a while is two; crumbs are swept away."""
        if blob.unseen > 0 or blob.detected is not None:
            return [blob]
        waist = parting_column(blob, scene.newcomers)
        parting = 0.0 if waist is None else blob.parting + scene.elapsed
        blob = blob.changed(parting=parting)
        if waist is not None and parting >= self.parting_time:
            larger, smaller = halves(blob, waist)
            if smaller.sum() >= max(self._least_area(scene), 0.25 * larger.sum()):
                blob, new = blob.changed(parting=0.0, still=0.0), next(numbers)
                return [
                    blob.changed(mask=larger, size=likely_size(larger)),
                    blob.changed(mask=smaller, size=likely_size(smaller), identity=new, whole=new),
                ]
        due = blob.seen // SWEEP > (blob.seen - scene.elapsed) // SWEEP
        return [blob.changed(mask=without_crumbs(blob.mask)) if due else blob]
