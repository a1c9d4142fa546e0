"""Whether the search finds people who move, and how many modes it takes for that."""

import numpy as np
import pytest
from rsmcm.inference.sfm.nonrigid.learning import learn_shape
from rsmcm.inference.sfm.nonrigid.shape import shape_error

from ....support.deforming import N_BASES, deforming
from ....support.stick_figures import stick_figure

BASES = 5


def test_modes_that_only_fit_noise_are_taken_away() -> None:
    found = learn_shape(deforming(seed=3)[0], N_BASES, iterations=40)
    assert len(found.details) == 0
    assert found.detail_weights.shape == (60, 0)


def test_a_person_before_a_camera_that_goes_round() -> None:
    truth = stick_figure(200, seed=1)
    found = learn_shape(truth[..., :2], BASES, iterations=60)
    assert shape_error(found.shapes(), truth) < 0.08
    assert len(found.bases) == BASES
    assert len(found.details) > 0  # a person bends in more ways than four
    gaps = [each.log_likelihood_gap for each in found.rivals]
    assert gaps == sorted(gaps)
    assert all(each.disagreement > 0.01 for each in found.rivals)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.slow
def test_more_people(seed: int) -> None:
    truth = stick_figure(300, seed)
    tracks = truth[..., :2].copy()
    if seed == 4:
        hidden = np.random.default_rng(0).random(tracks.shape[:2]) < 0.2
        tracks[hidden] = np.nan
    assert shape_error(learn_shape(tracks, BASES).shapes(), truth) < 0.08
