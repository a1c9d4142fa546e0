"""Methods to compare on the same frames: the model's engines, and the usual pipeline."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...inference import RecursiveBP
from ...inference.core.recursive_bp import RunState
from ...models.core.frame import Frame
from ..experiments.trials.baselines import CleanUp, KalmanHungarian, Subtractor, component_boxes
from ..io.mot import TrackedBox
from .application import Found, build_model, found_in
from .job import Camera, Engine
from .parameters import Parameters

Image = NDArray[np.uint8]

CHAINS: tuple[tuple[str, Engine], ...] = (("feed-forward", "feed-forward"), ("RSMCM", "recursive-bp"))
"""What is compared through the feedback of one connection and nothing else."""


class Method(Protocol):
    """Something that finds foreground, and perhaps tracks, frame by frame."""

    name: str
    tracks: bool  # whether it can

    def step(self, frame: Frame) -> Found:
        """Take in the next frame."""
        ...


class Model:
    """A multi-chain model.

    Parameters
    ----------
    name
        for tables.
    engine, parameters, camera
        as `build_model` takes them.
    size
        `(width, height)` px of the pictures.
    """

    def __init__(
        self,
        name: str,
        engine: Engine,
        size: tuple[int, int],
        parameters: Parameters | None = None,
        camera: Camera = "fixed",
    ) -> None:
        self.name = name
        self.tracks = engine != "stand-alone"
        self._size = size
        self._engine = RecursiveBP(build_model(engine, parameters, camera))
        self._state = RunState()

    def step(self, frame: Frame) -> Found:
        """Take in the next frame."""
        belief = self._engine.step(self._state, frame)
        self._state = belief.state
        return found_in(belief, self._size)

    def background(self) -> Image:
        """The background as it is believed now, `(height, width[, 3])` uint8."""
        if not self._state.states:
            return np.zeros((self._size[1], self._size[0]), np.uint8)
        picture: Image = self._state.states["background"].picture()
        return picture


class ModelSubtractor:
    """A model as something that turns picture after picture into masks."""

    def __init__(
        self, engine: Engine, size: tuple[int, int], rate: float, parameters: Parameters | None = None
    ) -> None:
        self._model = Model("", engine, size, parameters)
        self._rate = rate
        self._count = 0

    def apply(self, image: Image, /) -> Image:
        """Take the next picture; return 0 background, 255 foreground."""
        self._count += 1
        return self._model.step(Frame(image, self._count / self._rate, self._count)).foreground


class Usual:
    """A subtractor, a clean-up of its mask, Kalman filters and the Hungarian method on the components' boxes.

    Parameters
    ----------
    name
        for tables.
    subtractor
        fresh.
    clean_up
        of every mask.
    size
        `(width, height)` px of the pictures.
    """

    tracks = True

    def __init__(self, name: str, subtractor: Subtractor, clean_up: CleanUp, size: tuple[int, int]) -> None:
        self.name = name
        self._subtractor = subtractor
        self._clean_up = clean_up
        self._tracker = KalmanHungarian()
        self._mask: Image = np.zeros((size[1], size[0]), np.uint8)

    def step(self, frame: Frame) -> Found:
        """Take in the next frame; a missing one leaves the mask as it was."""
        if frame.image is not None:
            self._mask = self._clean_up.apply(self._subtractor.apply(frame.image))
        found = self._tracker.update(component_boxes(self._mask))
        return Found(self._mask, [TrackedBox(int(i), (x, y, w, h)) for i, x, y, w, h in found.tolist()])
