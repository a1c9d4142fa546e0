"""What the background application's chains predicted of pixels and boxes, for `rsmcm validity`."""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference import Belief, Incoming, MultiChain
from ...inference.engine.recursive_bp import RunState
from ...models.core.gaussian_message import GaussianMessage
from ...models.objects.box_message import BoxMessage
from ...models.objects.object_boxes import ObjectBoxes
from ...models.pixels.layers import LayerStack
from ...models.pixels.pixel_labels import PixelMessage
from ..evaluation.predictions import SAVED as SAVED_PAIRS
from ..evaluation.predictions import PairRecorder, Record, ScoreRecord

EVERY = 0.4
"""s between two frames whose pixels are recorded."""

COVERED = 0.05
"""Probability of being covered by a blob above which a pixel may be."""

MOST_BOXES = 4000
"""That are held, as many."""

SURE = 0.9
"""Probability from which on a detection counts as an observation of the object that it is given to."""

MOST_FRAMES = 4000
"""Of which scores are held: when there are more, every other one is dropped."""

SAVED = {
    "pixels": {"rows": list[tuple[int, tuple[float, float, float]]], "every": float, "last": float | None},
    "boxes": SAVED_PAIRS,
}
"""Kinds of what `Predictions.saved` returns."""


class Predictions:
    """Gathers, while a run goes on, what its chains `background` and `blobs` predict of what they share."""

    def __init__(self, model: MultiChain) -> None:
        self._before = RunState()
        self._pixels = PixelScores(model)
        self._objects: ObjectBoxes = model.features["objects"]
        self._boxes = PairRecorder("blobs", "ground", "boxes", most=MOST_BOXES)

    def on_frame(self, belief: Belief) -> None:
        """Note what was predicted of a frame."""
        self._pixels.on_frame(self._before, belief)
        self._before = belief.state
        observed = None if belief.frame.boxes is None else _observed(belief.evidence(self._objects))
        if observed is not None:
            # pixels and the past are all that they have heard of: a detector is new to both
            blobs, ground = (belief.message(name, self._objects) for name in ("blobs", "ground"))
            self._boxes.add(belief.frame.number, blobs.expected, ground.expected, observed)

    def records(self) -> list[Record]:
        """Everything that was gathered."""
        boxes = self._boxes.record()
        return [*([] if boxes is None else [boxes]), *self._pixels.record()]

    def saved(self) -> dict[str, Any]:
        """Everything as plain JSON."""
        return {"pixels": self._pixels.saved(), "boxes": self._boxes.saved()}

    def restore(self, saved: Mapping[str, Any], before: RunState) -> None:
        """Take up what `saved` kept; the run goes on from the state `before`."""
        self._before = before
        self._pixels.restore(saved["pixels"])
        self._boxes.restore(saved["boxes"])


class PixelScores:
    """How well background and blobs, each from its past alone, predict the pixels that blobs may cover.

    Both chains' messages of the run have heard of the image (the light, the blobs' places), so that they are
    worked out again from the states before: under the light of the frame before, at the predicted places.
    Which pixels are judged is decided by the prediction as well.
    """

    def __init__(self, model: MultiChain) -> None:
        self._background, self._blobs = model.chains["background"], model.chains["blobs"]
        self._pixels = model.features["pixels"]
        self._rows: list[tuple[int, Sequence[float]]] = []
        self._every, self._last = EVERY, -inf

    def on_frame(self, before: RunState, belief: Belief) -> None:
        """A frame, and the state before it."""
        frame = belief.frame
        if frame.image is None or not before.states or frame.time < self._last + self._every:
            return
        layers = self._predicted(self._blobs, before, frame.time).layers
        seen: PixelMessage = belief["pixels"]
        if seen.image is None:  # a moving camera has not found the scene
            return
        among = _covered(layers, seen.size)
        if seen.view is not None:
            among &= ~seen.view.hidden
        count = np.count_nonzero(among)
        if not count:
            return
        self._last = frame.time
        background = PixelMessage(self._predicted(self._background, before, frame.time).background)
        blobs, image = PixelMessage(layers=layers), PixelMessage(image=seen.image)
        messages = (background, blobs, background * blobs)
        scores = [(message * image).log_density(among) / count for message in messages]
        self._rows.append((frame.number, scores))
        if len(self._rows) > MOST_FRAMES:
            self._rows, self._every = self._rows[::2], 2 * self._every

    def record(self) -> list[Record]:
        """Everything that was gathered."""
        if not self._rows:
            return []
        frames = np.array([number for number, _ in self._rows], np.int64)
        scores = np.array([scores for _, scores in self._rows], np.float64)
        return [ScoreRecord("background", "blobs", "pixels", "a pixel", scores, frames)]

    def saved(self) -> dict[str, Any]:
        """Everything as plain JSON."""
        return {"rows": self._rows, "every": self._every, "last": self._last if self._rows else None}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Take up what `saved` kept."""
        self._rows = list(saved["rows"])
        self._every = saved["every"]
        self._last = -inf if saved["last"] is None else saved["last"]

    def _predicted(self, chain: Any, before: RunState, time: float) -> PixelMessage:
        state = chain.predict(before.states[chain.name], time - before.time)
        message: PixelMessage = chain.message(state, self._pixels, Incoming({self._pixels: PixelMessage()}))
        return message


def _observed(evidence: BoxMessage) -> GaussianMessage | None:
    """Boxes of the objects that a detector has found for sure."""
    found = evidence.association
    if found is None or not len(found) or not len(found.identities):
        return None
    best = found.pairs.argmax(axis=1)
    sure = np.flatnonzero(found.pairs.max(axis=1) > SURE)
    noise = found.noise[best[sure]][:, :, None] * np.eye(found.noise.shape[1])
    return GaussianMessage.from_moments(found.identities[sure], found.boxes[best[sure]], noise)


def _covered(layers: LayerStack, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels that layers may cover."""
    covered = np.zeros(size, bool)
    for part in layers.composed(None, size):
        covered[part.window] |= part.clear < 1 - COVERED
    return covered
