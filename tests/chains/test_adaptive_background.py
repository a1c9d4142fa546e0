"""The Gaussian background as a chain of its own."""

import numpy as np
import pytest
from rsmcm.chains import AdaptiveBackground
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels


@pytest.mark.parametrize("rate", [5, 12.5, 25, 50])
def test_a_lasting_colour_settles_after_the_same_time_at_any_rate(rate: float) -> None:
    images = [np.full((8, 9), 60 if time < 4 else 160, np.uint8) for time in np.arange(0, 9, 1 / rate)]
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(follow_light=False), pixels)
    masks = [belief[pixels].foreground() for belief in RecursiveBP(model).run(images, dt=1 / rate)]
    foreground = np.array([mask.mean() / 255 for mask in masks])
    assert foreground.sum() / rate == pytest.approx(3, abs=2.5 / rate)


@pytest.mark.parametrize(("settle_time", "settled"), [(3.0, True), (np.inf, False)])
def test_a_lasting_colour_settles_unless_told_not_to(settle_time: float, settled: bool) -> None:
    images = [np.full((8, 9), 60 if number < 5 else 160, np.uint8) for number in range(300)]
    pixels = PixelLabels()
    chain = AdaptiveBackground(settle_time=settle_time, follow_light=False)
    *_, last = RecursiveBP(MultiChain().connect(chain, pixels)).run(images)
    assert (last[pixels].foreground() == (0 if settled else 255)).all()
