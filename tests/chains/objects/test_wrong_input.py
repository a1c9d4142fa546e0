"""What is wrong with a parameter or an argument is one line, which names it."""

from collections.abc import Callable

import numpy as np
import pytest
from rsmcm.chains import (
    AdaptiveBackground,
    BlobTracker,
    MixtureBackground,
    ObjectTrajectories,
    SceneFilter,
)
from rsmcm.inference import MultiChain
from rsmcm.models import Frame, Layer, LayerStack, ObjectBoxes, PixelLabels, PixelMessage
from rsmcm.models.objects.box_message import BoxDetector, BoxMessage, LogOdds, Scores

MASK = np.full((4, 5), 0.5, np.float32)
GREY = PixelMessage(image=np.zeros((8, 9), np.uint8))


def layer(mask: object = MASK, appearance: object = None, **values: object) -> Layer:
    return Layer(**{"top": 0, "left": 0, "mask": mask, "appearance": appearance, **values})  # type: ignore[arg-type]


WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: BlobTracker(min_area=0), "min_area: got 0, expected more than 0"),
    (lambda: BlobTracker(likelihood_power=np.nan), "likelihood_power: got nan, expected a finite number"),
    (lambda: BlobTracker(max_coast_time=float("inf")), "max_coast_time: got inf, expected a finite number"),
    (lambda: BlobTracker(outliers=1), "outliers: got 1, expected a share between 0 and 1"),
    (lambda: BlobTracker(split_time="1 s"), "split_time: got '1 s', expected a number"),
    (lambda: BlobTracker(name=3), "name: got 3, expected a text"),
    (lambda: BlobTracker().initial(Frame(None, 0.0, 3)), "frame 3: got no image"),
    (lambda: AdaptiveBackground(prior=1.0), "prior: got 1.0, expected a probability"),
    (lambda: AdaptiveBackground(noise=0.0), "noise: got 0.0, expected more than 0"),
    (lambda: AdaptiveBackground(drift=-1.0), "drift: got -1.0, expected 0 or more"),
    (lambda: AdaptiveBackground(settle_time=0.0), "settle_time: got 0.0, expected more than 0"),
    (lambda: AdaptiveBackground(follow_light=1), "follow_light: got 1, expected True or False"),
    (lambda: MixtureBackground(background_share=0.0), "background_share: got 0.0, expected a share"),
    (lambda: MixtureBackground(components=2.5), "components: got 2.5, expected a whole number"),
    (lambda: MixtureBackground(components=0), "components: got 0, expected 1 or more"),
    (lambda: ObjectTrajectories(max_gap_time=0), "max_gap_time: got 0, expected more than 0"),
    (lambda: SceneFilter(AdaptiveBackground()), "model: got AdaptiveBackground(), expected a MultiChain"),
    (lambda: SceneFilter(MultiChain(), memory=0), "memory: got 0, expected more than 0"),
    (lambda: BoxDetector(found=1), "found: got 1, expected a probability"),
    (lambda: BoxDetector(position=float("nan")), "position: got nan, expected a finite number"),
    (lambda: LogOdds(np.array([1, 2]), np.zeros(3)), "values: got shape (3,), expected shape (n,)"),
    (lambda: LogOdds(np.array([1]), np.array([np.nan])), "values: got NaN or infinity"),
    (lambda: BoxMessage([1, 2]), "objects: got [1, 2], expected a GaussianMessage"),
    (lambda: BoxMessage(detector=0.9), "detector: got 0.9, expected a BoxDetector or None"),
    (lambda: Scores(1.0, 0.0, 0.0), "deviation: got 0.0, expected more than 0"),
    (lambda: ObjectBoxes("boxes"), "detector: got 'boxes', expected a BoxDetector"),
    (lambda: PixelLabels(3), "name: got 3, expected a text"),
    (lambda: layer(mask=MASK[0]), "mask: got shape (5,), expected shape (height, width)"),
    (lambda: layer(mask=MASK + np.nan), "mask: got NaN or infinity, expected finite numbers"),
    (lambda: layer(mask=3 * MASK), "mask: got values from 0.0 to 1.5, expected probabilities from 0 to 1"),
    (lambda: layer(mask=-MASK), "mask: got values from -0.5 to 0.0, expected probabilities from 0 to 1"),
    (lambda: layer(appearance=np.zeros((3, 5, 4))), "appearance: got shape (3, 5, 4), expected shape"),
    (lambda: layer(top=0.5), "top: got 0.5, expected a whole number"),
    (lambda: LayerStack(layer()), "layers: got Layer("),
    (lambda: PixelMessage(layers=[layer()]), "layers: got [Layer("),
    (lambda: PixelMessage(image=np.zeros((0, 9), np.uint8)), "image: got an array of uint8 of shape (0, 9)"),
    (lambda: PixelMessage(image=np.zeros((8, 9))), "image: got an array of float64 of shape (8, 9)"),
    (lambda: GREY.log_odds((1, 2, 3)), "region: got (1, 2, 3), expected 4 values"),
    (lambda: GREY.log_odds((0, 0, -4, 5)), "region[2]: got -4, expected 0 or more"),
    (lambda: GREY.log_density(np.ones((2, 2), bool)), "among: got shape (2, 2), expected that of the image"),
    (lambda: PixelMessage().log_density(np.ones((2, 2), bool)), "pixel message: got no image"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), WRONG, ids=[words for _, words in WRONG])
def test_wrong_input_is_one_line(call: Callable[[], object], words: str) -> None:
    with pytest.raises((TypeError, ValueError)) as error:
        call()
    assert str(error.value).startswith(words)
    assert "\n" not in str(error.value)
