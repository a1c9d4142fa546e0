"""Trackers that are given one image after the other, over the models of the applications.

    tracker = ObjectTracker()
    for image in camera:
        objects = tracker.update(image, boxes=detector(image))

Images are uint8, `(height, width)` or `(height, width, 3)` in the order BGR, as OpenCV reads them; `None`
stands for a missing image, for which everything is predicted. Boxes, in both directions, are `(n, 4)`
px: left, top, right, bottom, as detectors and supervision have them (`xyxy`). `time` is in seconds and
increases; without it, images are evenly spaced.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...inference import Belief, RecursiveBP, RunState
from ...inference.engine import checkpoint
from ...inference.engine.graph import require_later
from ...models.core.checks import Bound, checked, shown
from ...models.core.frame import BoundingBox, Frame, GivenBoxes
from ...models.core.short_repr import short_repr

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Picture = Annotated[Image, Bound(lambda image: image.size > 0, "an image with pixels")]
Result = TypeVar("Result")
Start = TypeVar("Start")


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class TrackerState(Generic[Start]):
    """State of a tracker after an image: an immutable value that can be kept, and assigned to `state`.

    Parameters
    ----------
    run
        state of the engine.
    start
        the tracked face or person; `None` for objects and points, and before the first detection.
    settings
        of the tracker: only one with the same settings can continue.
    trial
        faces found in the last images that still have to be confirmed, the latest last.
    """

    run: RunState
    start: Start | None
    settings: Mapping[str, Any]
    trial: Sequence[Start] = ()


class Tracker(ABC, Generic[Start, Result]):
    """Base of all trackers: an engine and its state.

    Parameters
    ----------
    frame_rate
        images per second, if `update` gets no time.
    settings
        on which the state depends, plain JSON.
    """

    start_type: ClassVar[Any] = type(None)
    _state: TrackerState[Start]

    def __init__(self, frame_rate: float, **settings: Any) -> None:
        self._interval, self._settings = 1 / frame_rate, {"tracker": type(self).__name__, **settings}
        self.reset()

    @property
    def state(self) -> TrackerState[Start]:
        """The state after the last image. Assign one to go on from it."""
        return self._state

    @state.setter
    def state(self, state: TrackerState[Start]) -> None:
        if not isinstance(state, TrackerState):
            raise TypeError(f"state: got {shown(state)}, expected a TrackerState")
        got, own = state.settings.get("tracker"), type(self).__name__
        if got != own:
            raise ValueError(f"state: got one of {got or 'another program'}, expected one of {own}")
        checkpoint.require_same("state", dict(state.settings), self._settings)
        if state.start is not self._state.start:
            self._engine = self._build(state.start)
        self._state = state

    def reset(self) -> None:
        """Forget everything: the next image is the first."""
        self._state = TrackerState(RunState(), None, self._settings)
        self._engine = self._build(None)

    def save(self, path: str | Path) -> None:
        """Write the state to an `.npz` file, whole or not at all."""
        state = self._state
        values = {
            "settings": dict(state.settings),
            "start": state.start,
            "trial": state.trial,
            "run": state.run.saved(),
        }
        checkpoint.save(path, values, self._kinds())

    def load(self, path: str | Path) -> None:
        """Go on from a state that `save` wrote; a `ValueError` says what does not fit."""
        contents = checkpoint.read(path)
        settings = contents.plain("settings")
        try:
            if isinstance(settings, dict) and settings.get("tracker") == type(self).__name__:
                values = checkpoint.load(contents, self._kinds())
                values["run"] = RunState.restored(values["run"])
                self.state = TrackerState(**values)
            else:
                self.state = TrackerState(RunState(), None, settings if isinstance(settings, dict) else {})
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def __repr__(self) -> str:
        return f"{type(self).__name__}(after {self._state.run.number} images)"

    @abstractmethod
    def _build(self, start: Start | None) -> RecursiveBP | None:
        """Return the engine; `None` where it needs a start."""

    @abstractmethod
    def _chains(self) -> Mapping[str, Any]:
        """Return the chains, or their classes, by name."""

    def _kinds(self) -> dict[str, Any]:
        return {
            "settings": dict[str, Any],
            "start": self.start_type | None,
            "trial": GenericAlias(tuple, (self.start_type, ...)),
            "run": RunState.kinds(self._chains()),
        }

    def _frame(self, image: Image | None, time: float | None, **given: Any) -> Frame:
        run = self._state.run
        if time is None:
            time = run.time + self._interval if run.number else 0.0
        frame = Frame(image, time, run.number + 1, **given)
        require_later(frame, run.time, run.number)
        return frame

    def _step(self, frame: Frame) -> Belief:
        assert self._engine is not None
        belief = self._engine.step(self._state.run, frame)
        self._state = replace(self._state, run=belief.state)
        return belief


class DetectingTracker(Tracker[Start, Result]):
    """Base of trackers of one face or person, whom a detector finds where images show one for sure.

    Parameters
    ----------
    detector
        model file of YuNet (.onnx) or a cascade (.xml) that finds the face; that of OpenCV 4 without it.
    seed
        of all random draws.
    frame_rate, settings
        images per second, where `update` is given no time.
    """

    def __init__(self, detector: str | Path | None, seed: int, frame_rate: float, **settings: Any) -> None:
        self._detector = None if detector is None else Path(detector)
        self._seed = seed
        super().__init__(frame_rate, seed=seed, **settings)

    def _started(self, frame: Frame, find: Callable[[Frame], Start | None]) -> bool:
        """Return whether there is a face or person, who is looked for in this frame if not."""
        if self._state.start is None:
            start = None if frame.image is None else find(frame)
            shape = self._state.run.shape if frame.image is None else frame.image.shape
            if start is None:
                trial = () if frame.image is None else self._state.trial
                run = RunState({}, frame.number, frame.time, shape)
                self._state = replace(self._state, run=run, trial=trial)
                return False
            self._engine = self._build(start)
            self._state = replace(self._state, start=start, trial=())
        return True


def size_of(box: ArrayLike) -> BoundingBox:
    """Return x, y, width, height px of a box: left, top, right, bottom."""
    left, top, right, bottom = GivenBoxes.of(np.array(box, np.float64)[None]).xyxy[0].tolist()
    return left, top, right - left, bottom - top
