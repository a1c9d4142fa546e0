"""The trial of hidden points: bars, and what counts as found again."""

import numpy as np
import pytest
from rsmcm.apps.experiments.hidden_points import (
    ENTER,
    MODELS,
    SOON,
    behind_a_bar,
    compared,
    expectations_of,
    tracked,
    with_bar,
)
from rsmcm.models.core.frame import Frame

from ...support.pictures import film, sliding

N_FRAMES = ENTER + 30


def plain(colour: bool = False) -> list[Frame]:
    shape = (120, 160, 3) if colour else (120, 160)
    return [Frame(np.zeros(shape, np.uint8), t / 25, t + 1) for t in range(N_FRAMES)]


@pytest.mark.parametrize("colour", [False, True])
def test_a_bar_comes_late_covers_what_it_says_and_carries_its_texture(colour: bool) -> None:
    frames, hidden = with_bar(plain(colour), 3)
    assert not hidden[:ENTER].any()
    assert hidden[ENTER:].any(axis=(1, 2)).mean() > 0.5
    for frame, mask in zip(frames, hidden, strict=True):
        assert frame.image is not None
        assert not frame.image[~mask].any()
    middle = (ENTER + N_FRAMES) // 2
    one, other = (frames[t].image for t in (middle, middle + 1))
    assert one is not None
    assert other is not None
    assert (one[hidden[middle]] > 0).mean() > 0.9
    again, _ = with_bar(plain(colour), 3)
    np.testing.assert_array_equal(again[middle].image, one)
    assert (with_bar(plain(colour), 4)[1] != hidden).any()


def test_what_counts_as_found_again() -> None:
    """Five points that stand still, behind a bar for ten frames; the last is not seen without it either."""
    truth = np.tile(
        np.array([[20.0, 20.0], [30.0, 20.0], [40.0, 20.0], [50.0, 20.0], [60.0, 20.0]]), (N_FRAMES, 1, 1)
    )
    hidden = np.zeros((N_FRAMES, 50, 80), bool)
    hidden[ENTER + 2 : ENTER + 12, 10:30] = True
    shown = ~hidden[:, 20, 20]
    truth[ENTER + 12 + SOON - 1, 4] = np.nan
    found = np.where(shown[:, None, None], truth, np.nan)
    found[ENTER + 12 :, 1] = np.nan  # never found again
    found[ENTER + 12 :, 2] += 3.0  # somewhere else
    found[ENTER + 12 : ENTER + 12 + SOON, 3] = np.nan  # too late
    found[ENTER + 3, 0] = truth[0, 0]  # seen through the bar
    result = compared(found, truth, hidden)
    np.testing.assert_array_equal(result.again, [True, False, False, False])
    np.testing.assert_allclose(result.wrong, [0, 0, 1, 0])
    np.testing.assert_allclose(result.false, [0.1, 0, 0, 0, 0])


def test_both_models_are_tried_behind_a_bar() -> None:
    frames = [Frame(grey, t / 25, t + 1) for t, grey in enumerate(film(sliding(ENTER + 12)))]
    truth = {name: tracked(frames, feedback) for name, feedback in MODELS.items()}
    refound = {name: [each] for name, each in behind_a_bar(frames, truth, None, 0).items()}
    names = [each.what.partition(":")[0] for each in expectations_of(refound)]
    assert list(dict.fromkeys(names)) == list(MODELS)
