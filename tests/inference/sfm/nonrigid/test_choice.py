"""How many bases tracks are said to tell, where it is known how many there are."""

import numpy as np
import pytest
from rsmcm.inference.sfm.nonrigid.learning import LEAST_LEFT, choose_bases, withheld

from ....support.deforming import N_BASES, deforming, holes


def test_as_many_as_there_are() -> None:
    positions, _ = deforming()
    found = choose_bases(positions, range(2, 5))
    assert found.bases == N_BASES
    assert found.candidates == (2, 3, 4)
    assert found.errors[0] > 1.5 * found.errors[1]


def test_frames_and_points_keep_what_they_need() -> None:
    positions = holes(deforming(n_frames=40)[0], 0.3)
    positions[5, 5:] = np.nan
    positions[6:, 3] = np.nan
    seen = ~np.isnan(positions[..., 0])
    hidden = withheld(positions)
    assert not (hidden & ~seen).any()
    assert not hidden[5].any()
    left = seen & ~hidden
    for axis in (0, 1):
        assert (left.sum(axis=axis) >= np.minimum(LEAST_LEFT, seen.sum(axis=axis))).all()
    assert hidden.sum() == pytest.approx(0.1 * seen.sum(), rel=0.4)
