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
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.protocols import Cavity, Incoming, Port
from ...models.core.checks import Positive, Share, checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import BoxMessage
from ...models.objects.object_boxes import ObjectBoxes
from ...models.pixels.layers import LayerStack, log_uniform
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from . import detections
from .blob_scene import VIEW_TIME, BlobScene, Learning, find_spots, inherited_evidence
from .blobs import Blob, Blobs, BlobState, front_to_back, layers_of, likely_size
from .groups import fragment_times, group_parts, merge_pieces, select_whole, split_columns, split_mask
from .left_behind import LeftBehind
from .registration import register_blobs

SWEEP = 0.8  # s after which a mask is freed of crumbs again
OF_TRACKER = (
    "outliers", "strength", "colour_variance", "likelihood_power", "ghost_threshold", "confirmation_time",
    "max_coast_time", "max_hidden_time",
)  # fmt: skip
"""Parameters of `BlobTracker` by which blobs are learned."""

FADING = 0.06  # s, time constant with which a mask fades where it reaches too far


@short_repr
@checked
@dataclass(frozen=True)
class BlobTracker:
    """Tracker of any number of blobs.

    Lengths are relative to the size of the image or of the blob.

    Parameters
    ----------
    min_area
        minimum area of a new object, as a share of the area of the image.
    mask_time, colour_time
        s, time constants of the updates of a mask and its colours.
    colour_variance
        squared grey levels, upper bound of the variance of an object's colours, and its initial value.
    outliers
        share of an object's pixels whose colour is not as remembered.
    strength
        prior odds of a known object over an unknown one in front of the background.
    likelihood_power
        exponent of the likelihood of the pixels in registration, since neighbours are not independent.
    acceleration
        blob lengths/s^2, standard deviation of the acceleration, with a correlation time of half a second.
    initial_velocity_std
        blob lengths/s, standard deviation of a new blob's velocity.
    max_coast_time, max_hidden_time
        s for which an unseen blob is kept: one that should be visible, and one that is hidden by another.
    confirmation_time
        s for which an object must be seen before it is reported.
    ghost_threshold
        nats, evidence above which a blob is a ghost: log ratio of its outline as an edge of the background
        image over an edge of the image (see `chains.objects.blob_scene`).
    split_time
        s for which a blob must look like two people (a narrow waist, or the width of two) before it is split.
    size_time
        s, time constant of the mean size of a blob, which bounds its mask.
    """

    min_area: Positive = 0.0003
    mask_time: Positive = 0.4
    colour_time: Positive = 0.4
    colour_variance: Positive = 300.0
    outliers: Share = 0.1
    strength: Positive = 10.0
    likelihood_power: Positive = 0.15
    acceleration: Positive = 0.9
    initial_velocity_std: Positive = 2.0
    max_coast_time: Positive = 0.6
    max_hidden_time: Positive = 3.0
    confirmation_time: Positive = 0.35
    ghost_threshold: Positive = 5.0
    split_time: Positive = 0.4
    size_time: Positive = 2.0
    name: str = "blobs"

    ports = (Port(PixelLabels, Cavity.OTHERS), Port(ObjectBoxes, optional=True))

    def initial(self, frame: Frame) -> BlobState:
        """Return a state without objects: objects in the first frame are background until they move."""
        image = frame.required_image()
        channels = 1 if image.ndim == 2 else image.shape[2]
        none, left = Blobs.none(channels), LeftBehind.nothing(image)
        return BlobState(none, 0, image.shape[:2], 0.0, self.confirmation_time, left, candidates=none)

    def predict(self, state: BlobState, dt: float) -> BlobState:
        """Predict all blobs `dt` seconds ahead: constant velocity with white acceleration."""
        blobs, candidates = (
            detections.predict(each, dt, self.acceleration, state.detecting)
            for each in (state.blobs, state.candidates)
        )
        return replace(state, blobs=blobs, candidates=candidates, elapsed=state.elapsed + dt)

    @overload
    def message(self, state: BlobState, feature: PixelLabels, incoming: Incoming) -> PixelMessage: ...
    @overload
    def message(self, state: BlobState, feature: ObjectBoxes, incoming: Incoming) -> BoxMessage: ...
    def message(
        self, state: BlobState, feature: PixelLabels | ObjectBoxes, incoming: Incoming
    ) -> PixelMessage | BoxMessage:
        """Return the message of all objects to a feature (mu_{S -> F})."""
        if isinstance(feature, PixelLabels):
            return PixelMessage(layers=self._placed(state, incoming)[3])
        pixels = incoming[PixelLabels]
        blobs, _ = incoming.once(self._registered, state, pixels)
        view = BoxMessage(view=pixels.view)
        if not len(blobs) and not len(state.candidates):
            return view
        is_seen = incoming.evidence(PixelLabels).image is not None
        if state.detecting and pixels.view is not None:
            is_seen = False  # what pixels alone show may be the camera's doing: near things, what it now sees
        blobs = select_whole(blobs)
        return view * detections.box_message(blobs, state.candidates, state.detecting, is_seen)

    def update(self, state: BlobState, incoming: Incoming) -> BlobState:
        """Update all objects by the frame: register, learn, merge, split, delete and create."""
        state, view = self._updated(state, incoming), incoming[PixelLabels].view
        if view is None or view.begins is None:
            return state
        return replace(
            state,
            blobs=state.blobs.seen_by(view),
            candidates=state.candidates.seen_by(view),
            left_behind=LeftBehind.nothing(view.begins),
        )

    def _updated(self, state: BlobState, incoming: Incoming) -> BlobState:
        pixels, boxes = incoming[PixelLabels], incoming.get(ObjectBoxes)
        blobs, newborn, candidates, layers = self._placed(state, incoming)
        if boxes is not None and boxes.association is not None:
            blobs = blobs.select(detections.are_kept(blobs, boxes, state.size))
            identities = [*candidates.table["identity"], *(each.identity for each in newborn)]
            state = replace(
                state,
                blobs=blobs.concatenate(newborn),
                candidates=candidates,
                born=int(max([state.born, *identities])),
                detecting=True,
            )
        if pixels.subtraction is None:
            return state
        scene = BlobScene(pixels, layers, boxes, state.elapsed)
        numbers, least_area = count(state.born + 1), self.min_area * scene.size[0] * scene.size[1]
        kept = Blobs.none(blobs.channels)
        if len(blobs) or newborn:
            learned, alive = scene.learn_blobs(blobs, self._rule(blobs.channels, scene, least_area))
            kept = learned.select(alive).concatenate(newborn)
            scene.colour_newborns(kept, int(alive.sum()))
            kept = group_parts(merge_pieces(self._split(kept, numbers, scene, least_area)), scene)
            kept = self._swept(kept, numbers, scene, least_area)
            kept.table["fragment_time"] = fragment_times(kept, scene)
        left = state.left_behind.after(
            scene.picture.image,
            kept,
            self._may_leave(kept),
            blobs.select(blobs.ghost_evidence >= self.ghost_threshold),
            least_area,
            scene.elapsed,
        )
        born = Blobs.none(kept.channels)
        for spot in find_spots(scene.picture.log_odds, kept, least_area):
            corner, mask, planes = scene.cut_out(spot, kept, born)
            if float(mask.sum()) >= least_area:
                new = Blob.newborn(
                    next(numbers), corner, mask, planes, self.initial_velocity_std, self.colour_variance
                )
                evidence = min(inherited_evidence(new, kept), inherited_evidence(new, born))
                born = born.concatenate([new.changed(past_views=evidence)])
        blobs = kept.concatenate(list(born))
        return replace(state, blobs=blobs, born=next(numbers) - 1, elapsed=0.0, left_behind=left)

    def _placed(self, state: BlobState, incoming: Incoming) -> tuple[Blobs, list[Blob], Blobs, LayerStack]:
        """Registered and corrected blobs, front to back; new ones; candidates; and the layers of both."""
        pixels, boxes = incoming[PixelLabels], incoming.get(ObjectBoxes)
        registered = incoming.once(self._registered, state, pixels)
        if boxes is None or boxes.association is None:
            return registered[0], [], state.candidates, registered[1]
        return incoming.once(self._detected, state, pixels, boxes, registered)

    def _detected(
        self, state: BlobState, pixels: PixelMessage, boxes: BoxMessage, registered: tuple[Blobs, LayerStack]
    ) -> tuple[Blobs, list[Blob], Blobs, LayerStack]:
        corrected = detections.correct(registered[0], boxes)
        known = detections.correct(state.candidates, boxes)
        candidates = known.concatenate(
            list(detections.new_candidates(state.born, boxes, state.size, corrected.channels))
        )
        likely, candidates = detections.sort_candidates(candidates, boxes, state.size)
        # born where there is no image, it is of any colour until there is one
        channels = 0 if pixels.image is None else corrected.channels
        new = [detections.newborn(each, boxes, channels, self.colour_variance) for each in likely]
        parts = detections.are_parts(corrected, Blobs.of(new, corrected.channels))
        blobs = front_to_back(corrected.select(~parts))
        return blobs, new, candidates, self._layers(front_to_back(blobs.concatenate(new)), state)

    def _registered(self, state: BlobState, pixels: PixelMessage) -> tuple[Blobs, LayerStack]:
        """Registered blobs, front to back, and their layers."""
        if not len(state.blobs):
            return state.blobs, state.left_behind.layers()
        blobs = front_to_back(state.blobs)
        if pixels.subtraction is not None:
            blobs = register_blobs(blobs, pixels, self.outliers, self.likelihood_power, state.elapsed)
        return blobs, self._layers(blobs, state)

    def _layers(self, blobs: Blobs, state: BlobState) -> LayerStack:
        layers = LayerStack(layers_of(blobs, self.outliers, self.strength, self.ghost_threshold))
        return layers * state.left_behind.layers()

    def _may_leave(self, blobs: Blobs) -> NDArray[np.bool_]:
        """`(n,)`: which blobs are sure enough to leave something behind."""
        table = blobs.table
        seen = (table["unseen"] == 0) & (table["seen"] >= self.confirmation_time)
        return np.asarray(seen & (blobs.ghost_evidence < self.ghost_threshold))

    def _rule(self, channels: int, scene: BlobScene, least_area: float) -> Learning:
        """Parameters by which blobs learn from this frame."""

        def share(time: float) -> float:
            return -math.expm1(-scene.elapsed / time)

        return Learning(
            log_uniform=log_uniform(channels),
            elapsed=scene.elapsed,
            mask_share=share(self.mask_time),
            colour_share=share(self.colour_time),
            view_share=share(VIEW_TIME),
            size_share=share(self.size_time),
            kept=math.exp(-scene.elapsed / FADING),
            least_area=least_area,
            **{name: getattr(self, name) for name in OF_TRACKER},
        )

    def _split(self, blobs: Blobs, numbers: Iterator[int], scene: BlobScene, least_area: float) -> Blobs:
        """Blobs that have had a waist or the width of two for a while are two."""
        table = blobs.table
        judged = (table["unseen"] == 0) & (table["detected"] == 0)
        waists = np.where(judged, split_columns(blobs, scene.newcomers), -1)
        longer = np.where(waists < 0, 0.0, table["parting"] + scene.elapsed)
        table["parting"] = np.where(judged, longer, table["parting"])
        parted = {}
        for k in np.flatnonzero((waists >= 0) & (longer >= self.split_time)).tolist():
            larger, smaller = split_mask(blobs[k], waists[k])
            if smaller.sum() >= max(least_area, 0.25 * larger.sum()):
                blob, new = blobs[k].changed(parting=0.0, still=0.0), next(numbers)
                parted[k] = [
                    blob.changed(mask=larger, size=likely_size(larger)),
                    blob.changed(mask=smaller, size=likely_size(smaller), identity=new, whole=new),
                ]
        if not parted:
            return blobs
        rows = [part for k, blob in enumerate(blobs) for part in parted.get(k, [blob])]
        return Blobs.of(rows, blobs.channels)

    def _swept(self, blobs: Blobs, numbers: Iterator[int], scene: BlobScene, least_area: float) -> Blobs:
        """Blobs whose masks are freed of crumbs now and then.

        Large ones are objects of their own if they differ from the scene; others trail behind what moves.
        """
        table = blobs.table
        judged = (table["unseen"] == 0) & (table["detected"] == 0)
        due = judged & (table["seen"] // SWEEP > (table["seen"] - scene.elapsed) // SWEEP)
        return blobs.concatenate(
            [
                blobs[k].part(next(numbers), crumb)
                for k in np.flatnonzero(due).tolist()
                for crumb in blobs.sweep(k, least_area)
                if scene.shows(crumb, *blobs[k].corner)
            ]
        )
