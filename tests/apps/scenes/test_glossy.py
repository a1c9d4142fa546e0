"""A room whose floor or table mirrors."""

import numpy as np
import pytest
from rsmcm.apps.scenes import glossy


@pytest.mark.parametrize("table", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.25])
def test_the_surface_shows_a_share_of_what_is_above(share: float, table: bool) -> None:
    room = glossy(
        80, 3, (160, 120), enter=0, stand=60, share=share, blur=0.0, table=table, noise=0.0, light_drift=0.0
    )
    there = room.reflection(60)
    image, empty = (room.image(index).astype(float) for index in (60, 0))
    assert there.sum() > 100
    assert not (there & room.foreground(60)).any()
    rows, columns = np.nonzero(there)
    above = 2 * (room._edge if table else round(room._feet)) - 1 - rows
    expected = (room._ground * (1 - share))[rows, columns] + share * image[above, columns]
    error = np.abs(image[rows, columns] - expected)
    assert np.quantile(error, 0.9) < 1.5, "but for pixels at outlines, which show two things"
    away = ~(there | room.foreground(60))
    assert np.abs(image - empty)[away].mean() < 0.5
