"""Contrasts about outlines, and what they say of ghosts."""

import numpy as np
import pytest
from rsmcm.chains.objects import blob_scene as kernels
from rsmcm.models.pixels.background import StoredPlanes

F4 = np.float32


@pytest.mark.parametrize(("width", "reach"), [(6, 1), (6, 2), (2, 2), (1, 3)])
def test_contrasts_across_an_outline_and_beside_it(width, reach):
    mask, out, within = np.zeros((30, 40), F4), np.empty((4, 4 * 1200), F4), (11, 16, 22, 24)
    mask[12:20, 17 : 17 + width] = 1
    planes = np.full((2, 30, 40), 50, F4)
    planes[:, mask > 0] = [[150], [90]]
    free = np.ones((30, 40), F4)
    picture = np.random.default_rng(0).uniform(0, 255, (2, 50, 60)).astype(F4)

    def contrasts(open_):
        picture[:, 7:37, 5:45] = planes[:, :, ::-1]
        behind = StoredPlanes(picture, F4(1))
        count = kernels.outline_contrasts(planes, 7, 5, behind, open_, mask, within, reach, out)
        # in the second picture all is the other way round
        other, behind = np.empty_like(out), StoredPlanes(planes, F4(1))
        turned = (planes[:, :, ::-1].copy(), 0, 0, behind, open_, mask, within, reach, other)
        assert kernels.outline_contrasts(*turned) == count
        np.testing.assert_array_equal(out[2:, :count], other[:2, :count])
        np.testing.assert_array_equal(out[:2, :count], other[2:, :count])
        return count

    count = contrasts(free)
    assert count == 2 * (8 + width)
    np.testing.assert_allclose(out[0, :count], np.hypot(100, 40))
    np.testing.assert_array_equal(out[1, :count], 0)
    planes[:] = 3 * np.arange(40)
    assert contrasts(free) == count
    slopes = np.unique(out[1, :count])
    np.testing.assert_allclose(slopes, [0, 6 * reach * np.sqrt(2)], rtol=1e-6)
    free[:, :17] = 0  # what covers the left side hides its outline, and places above and below next to it
    assert contrasts(free) == count - 8
    assert contrasts(0 * free) == 0
