"""The Gaussian background as a chain of its own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import AdaptiveBackground
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.inference.engine.protocols import Incoming, Port
from rsmcm.models import Frame, PixelLabels
from rsmcm.models.pixels import colour
from rsmcm.models.pixels.layers import Layer, LayerStack
from rsmcm.models.pixels.pixel_labels import PixelMessage

Image = NDArray[np.uint8]
Planes = NDArray[np.float32]


@pytest.mark.parametrize(("rate", "time", "lasts"), [(5, 3.0, 3), (25, 3.0, 3), (12.5, np.inf, 5)])
def test_a_lasting_colour_settles_after_the_same_time_at_any_rate(
    rate: float, time: float, lasts: float
) -> None:
    images = [np.full((8, 9), 60 if at < 4 else 160, np.uint8) for at in np.arange(0, 9, 1 / rate)]
    pixels = PixelLabels()
    chain = AdaptiveBackground(settle_time=time, follow_light=False)
    model = MultiChain().connect(chain, pixels)
    masks = [belief[pixels].foreground() for belief in RecursiveBP(model).run(images, dt=1 / rate)]
    foreground = np.array([mask.mean() / 255 for mask in masks])
    assert foreground.sum() / rate == pytest.approx(lasts, abs=2.5 / rate)


@dataclass(frozen=True)
class Spoken:
    """A chain that says what it was told to: layers by the number of the frame, then none."""

    layers: tuple[list[Layer], ...]
    name: str = "spoken"

    ports = (Port(PixelLabels),)

    def initial(self, frame: Frame) -> int:
        return 0

    def predict(self, state: int, dt: float) -> int:
        return state + (dt > 0)

    def message(self, state: int, feature: PixelLabels, incoming: Incoming) -> PixelMessage:
        return PixelMessage(layers=LayerStack(self.layers[state] if state < len(self.layers) else []))

    def update(self, state: int, incoming: Incoming) -> int:
        return state


ROOM = np.random.default_rng(0).integers(90, 170, (60, 80, 3)).astype(float)
PLACE = np.s_[10:50, 30:46]
MASK = np.zeros((40, 16), np.float32) + 0.9
PERSON = np.random.default_rng(1).integers(20, 70, (40, 16, 3)).astype(float)


def film(there: Sequence[bool], seed: int = 2) -> list[Image]:
    """Pictures of a room with or without somebody at one place."""
    rng, images = np.random.default_rng(seed), []
    for shown in there:
        picture = ROOM + rng.normal(0, 3, ROOM.shape)
        picture[PLACE] = PERSON + rng.normal(0, 3, PERSON.shape) if shown else picture[PLACE]
        images.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return images


def foreground(images: list[Image], layers: Sequence[list[Layer]], dt: float = 0.04) -> list[float]:
    """Share of the place that is foreground, frame by frame."""
    pixels = PixelLabels()
    background = AdaptiveBackground(follow_light=False)
    model = MultiChain().connect(background, pixels).connect(Spoken(tuple(layers)), pixels)
    return [float((b[pixels].foreground()[PLACE] > 0).mean()) for b in RecursiveBP(model).run(images, dt=dt)]


@pytest.mark.parametrize(
    ("appearance", "dt"),
    [(None, 0.04), (colour.to_planes(PERSON.astype(np.uint8)).reshape(3, 40, 16), 0.08)],
)
def test_behind_somebody_who_was_there_from_the_first_frame_the_scene_is_unknown(
    appearance: Planes | None, dt: float
) -> None:
    stays = round(8 / dt)
    layer = Layer(10, 30, MASK, appearance)
    shares = foreground(film([True] * stays + [False] * 20), [[layer]] * stays, dt)
    assert min(shares[1:stays]) > 0.98  # the background takes nothing in
    assert max(shares[stays:]) < 0.01  # whatever is seen then is background, at once
    without = foreground(film([True] * stays + [False] * 20), [], dt)
    assert max(without[:stays]) == 0
    assert max(without[stays:]) > 0.9  # a ghost, if nobody says that somebody stands there


def test_what_a_scene_was_known_to_be_is_not_forgotten_behind_an_object() -> None:
    layer = Layer(10, 30, MASK, None)
    there = [False] * 80 + [True] * 150 + [False] * 5 + [True] * 5
    shares = foreground(film(there), [[]] * 80 + [[layer]] * 150)
    assert min(shares[80:230]) > 0.98
    assert max(shares[230:235]) < 0.02
    assert min(shares[235:]) > 0.98


def test_a_wrong_verdict_of_ghost_heals() -> None:
    ghost = Layer(10, 30, np.ones((40, 16), np.float32), None, ghost=True)
    there = [False] * 50 + [True] * 50 + [False] * 100
    shares = foreground(film(there), [[]] * 60 + [[ghost]] * 2)
    assert min(shares[50:60]) > 0.98
    assert max(shares[61:100]) < 0.02  # believed
    assert max(shares[100:]) < 0.02  # and when they walk away the old scene is known at once
