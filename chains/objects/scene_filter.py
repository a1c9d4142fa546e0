"""Scene filter as a batch chain: background and objects of a whole film, filtered from its empty scene.

Of the chains in its model (the background R, objects S, and others):

    p(R_1, S_1, ..., R_T, S_T) = p(R_1) p(S_1) prod_t p(R_t | R_t-1) p(S_t | S_t-1)
    mu_{scene -> F_t} = product of what the chains in the model say of F_t, given the frames until then

In coordinate ascent (RSMCM paper, Algorithm 2) each chain in turn gets its best trajectory, the others held
fixed. Background and objects are too close for that: an object that stands is background as long as the
objects' chain is held where it has not found it, and is not found as long as the background's is held where
it has swallowed it. So the two are one coordinate here. Its best trajectory is found by the initial state:
R_1 comes from all of the film (see `chains.pixels.empty_scene`); the rest follows from it forwards, by
Algorithm 1, so that light, things that are left and cars that park are followed as ever. What is kept is
R_1 alone, and messages are worked out again in each pass.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, overload, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...inference.engine.graph import MultiChain
from ...inference.engine.protocols import BatchIncoming, Incoming, Port, Smoothed
from ...inference.engine.recursive_bp import Belief, ForwardPass, RecursiveBP, RunState
from ...models.core.checks import Count, Positive, checked
from ...models.core.frame import Frame
from ...models.core.short_repr import short_repr
from ...models.objects.box_message import BoxMessage
from ...models.objects.object_boxes import ObjectBoxes
from ...models.pixels.background import EmptyScene
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from .blobs import BlobState, Box, box_densities
from .object_trajectories import Boxes, messages_of

Numbers = NDArray[np.float64]

LONG = 60.0  # s, after which all objects of a film have left the picture
ROOM = 0.1  # of a box's size, around it: shadows, hair and feet that it leaves out
FEWEST_FRAMES = 9  # from which an empty scene is found, however large they are


@runtime_checkable
class SceneModel(Protocol):
    """Filtering chain that can estimate a background image of a video, and start from it."""

    def empty_scene(
        self,
        images: Sequence[NDArray[np.uint8]],
        times: Numbers,
        covered: Sequence[NDArray[np.bool_]] | None = None,
        /,
    ) -> EmptyScene:
        """Estimate the background from images `(height, width[, 3])` at `times` `(n_images,)` s.

        `covered` `(height, width)` are the pixels of known objects in each image.
        """
        ...

    def initial_in(self, scene: EmptyScene, /) -> Any:
        """Return the state of the chain before the first frame, given the background image."""
        ...


@short_repr
@dataclass(frozen=True, eq=False)
class SceneTrajectory:
    """Trajectory of the scene: the empty scene before the first frame, and the boxes that other chains sent.

    The rest follows from it, forwards. `times` are `(n_frames,)` s.
    """

    empty: EmptyScene
    times: Numbers
    boxes: Boxes

    @property
    def log_prior(self) -> float:
        """0: every scene is as likely beforehand."""
        return 0.0


@short_repr
@checked
@dataclass(frozen=True)
class SceneFilter:
    """Batch chain of background and objects: a filter that starts from a background image of the whole video.

    Parameters
    ----------
    model
        of filtering chains over one `PixelLabels` and optionally one `ObjectBoxes`, one of them a
        `SceneModel` such as `AdaptiveBackground`.
    memory
        s, time constant of the weights of frames for the background image, since cars park and leave, and
        light changes: frames that are so much later count 1/e.
    most_frames
        maximum number of frames for the background image, if they take less than `most_bytes`.
    most_bytes
        maximum memory of images.

    Raises
    ------
    ValueError
        if the model has no such chain.
    """

    model: MultiChain
    memory: Positive = 30.0
    most_frames: Count = 48
    most_bytes: Count = 1 << 28
    name: str = "scene"

    ports = (Port(PixelLabels, sole="background"), Port(ObjectBoxes, optional=True))

    def __post_init__(self) -> None:
        self._background()

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: SceneTrajectory | None = None
    ) -> Smoothed[SceneTrajectory]:
        """Estimate the background image from frames of the whole video.

        Pixels in boxes of other chains are excluded.

        Raises
        ------
        ValueError
            if no frame has an image.
        """
        first = next((each.frame.image for each in incoming_over_time if each.frame.image is not None), None)
        if first is None:
            raise ValueError("frames: got no image, expected one at least")
        times = np.array([each.time for each in incoming_over_time])
        boxes = Boxes.of(each.others(ObjectBoxes).objects for each in incoming_over_time)
        images, covered, seen = [], [], []
        for index in sample_of(times, self.sample_size(first.nbytes), self.memory):
            image = incoming_over_time[index].frame.image
            if image is not None:
                images.append(image)
                seen.append(times[index])
                covered.append(boxes.only(boxes.frames == index).mask(first.shape[:2], ROOM))
        return Smoothed(SceneTrajectory(self.empty_scene(images, np.array(seen), covered), times, boxes))

    def sample_size(self, n_bytes: int) -> int:
        """Return the number of images of `n_bytes` each for the background image."""
        return max(min(self.most_frames, self.most_bytes // n_bytes), FEWEST_FRAMES)

    def empty_scene(
        self,
        images: Sequence[NDArray[np.uint8]],
        times: Numbers,
        covered: Sequence[NDArray[np.bool_]] | None = None,
    ) -> EmptyScene:
        """Return the background image of a sample of images: see `SceneModel.empty_scene`."""
        return self._background()[1].empty_scene(images, times, covered)

    def _background(self) -> tuple[str, SceneModel]:
        """Name of the chain that estimates the background image, and the chain."""
        for name, chain in self.model.chains.items():
            if isinstance(chain, SceneModel):
                return name, chain
        raise ValueError(
            f"scene filter: got chains {', '.join(self.model.chains)}, expected one that estimates a "
            "background image (a SceneModel; background with model gaussian)"
        )

    @overload
    def messages(
        self, trajectory: SceneTrajectory, feature: PixelLabels, incoming: Sequence[BatchIncoming]
    ) -> Sequence[PixelMessage]: ...
    @overload
    def messages(
        self, trajectory: SceneTrajectory, feature: ObjectBoxes, incoming: Sequence[BatchIncoming]
    ) -> Sequence[BoxMessage]: ...
    def messages(
        self,
        trajectory: SceneTrajectory,
        feature: PixelLabels | ObjectBoxes,
        incoming: Sequence[BatchIncoming],
    ) -> Sequence[PixelMessage] | Sequence[BoxMessage]:
        """Return the filter's message for each frame (mu_{scene -> F})."""
        engine = RecursiveBP(self.model)
        start = self.initial_state(trajectory)

        def pixels(belief: Belief) -> PixelMessage:
            (labels,) = (node for node in self.model.features.values() if isinstance(node, PixelLabels))
            return replace(belief[labels], image=None)

        def boxes(belief: Belief) -> BoxMessage:
            states = (belief.states[name] for name in self.model.chains)
            seen = [each for state in states if isinstance(state, BlobState) for each in _seen(state)]
            if not seen or belief.frame.missing:
                return BoxMessage()
            return BoxMessage(box_densities(*(list(values) for values in zip(*seen, strict=True))))

        if isinstance(feature, PixelLabels):
            return ForwardPass(engine, start, incoming, pixels)
        return ForwardPass(engine, start, incoming, boxes)

    def initial_state(self, trajectory: SceneTrajectory) -> RunState:
        """Return the state of the filter before the first frame.

        It has no objects. Chains of boxes only are updated with all boxes of the video, and then predicted
        until all objects have left: static states, such as a ground plane, are kept.
        """
        state = self.state_in(trajectory.empty, float(trajectory.times[0]))
        states = dict(state.states)
        messages = messages_of(trajectory.boxes, len(trajectory.times))
        for name, chain in self.model.chains.items():
            # a detector's chain would take frames without detections for a time in which it did not run
            if len(trajectory.boxes) and all(
                issubclass(port.kind, ObjectBoxes) and port.sole != "detector" for port in chain.ports
            ):
                after, last = states[name], trajectory.times[0]
                for time, message in zip(trajectory.times, messages, strict=True):
                    after = chain.predict(after, time - last)
                    after, last = chain.update(after, Incoming({ObjectBoxes(): message})), time
                after = chain.predict(after, LONG)  # after which all objects have left
                states[name] = chain.update(after, Incoming({ObjectBoxes(): BoxMessage()}))
        return replace(state, states=states)

    def state_in(self, empty: EmptyScene, time: float) -> RunState:
        """Return the state before the first frame, at `time` s, given the background image only."""
        background, model = self._background()
        blank = Frame(np.zeros(empty.shape, np.uint8), time, 1)
        states: dict[str, Any] = {
            name: model.initial_in(empty) if name == background else chain.initial(blank)
            for name, chain in self.model.chains.items()
        }
        return RunState(states, 0, math.nextafter(time, -math.inf), empty.shape)


def _seen(state: BlobState) -> list[tuple[int, Box]]:
    """Identities and boxes of objects that the frame shows; with a detector, of confirmed ones."""
    shown = state if state.detecting else replace(state, confirmation_time=0.0)
    return [(each.identity, each.box) for each in shown.tracks() if each.seen or state.detecting]


def sample_of(times: Numbers, most: int, memory: float) -> list[int]:
    """Return indices of `most` frames at most, the fewer the later in the film, by exp(-time / memory)."""
    share = (np.arange(most) + 0.5) / most
    wanted = times[0] - memory * np.log1p(share * np.expm1((times[0] - times[-1]) / memory))
    after = np.searchsorted(times, wanted).clip(max=len(times) - 1)
    before = (after - 1).clip(min=0)
    nearest = np.where(wanted - times[before] < times[after] - wanted, before, after)
    return [int(index) for index in np.unique(nearest)]
