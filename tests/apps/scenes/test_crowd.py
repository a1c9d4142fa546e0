"""Crowds have as many walkers as asked for, and know their ground."""

import numpy as np
import pytest
from rsmcm.apps.scenes.crowd import BODY, crowd


@pytest.mark.parametrize("n_walkers", [1, 10, 40])
def test_walkers_are_all_seen_as_far_as_they_are_in_the_picture(n_walkers: int) -> None:
    """Within 60 frames, for a walker goes out of sight for up to 55."""
    empty, *frames = crowd(n_walkers, 60, (480, 640))
    area, changed = n_walkers * BODY[0] * BODY[1] * np.pi / 4, []
    for frame in frames:
        assert frame.image is not None
        assert empty.image is not None
        changed.append(np.sum(np.abs(frame.image.astype(int) - empty.image).max(axis=2) > 20))
    assert 0.4 * area < max(changed) < 1.05 * area


def test_who_does_not_fit_in_is_refused() -> None:
    with pytest.raises(ValueError, match="n_walkers: got 5000, expected fewer"):
        next(crowd(5000, 2, (120, 320)))
