"""Boxes that are cut out of a picture, against plain numpy in float64."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.chains.objects import blob_records as kernels
from rsmcm.chains.pixels.background_prediction import colour

F4 = np.float32


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([1, 3]),
    st.integers(-12, 25),
    st.integers(-20, 40),
    st.integers(1, 14),
    st.integers(1, 20),
)
def test_gather_cuts_a_box_out_of_the_picture(channels, top, left, rows, columns):
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (17, 29, channels)).astype(np.uint8)
    log_odds = rng.integers(-127, 128, (17, 29)).astype(np.int8)
    planes, odds, free = (
        np.full(shape, 9, F4) for shape in ((channels, rows, columns), *[(rows, columns)] * 2)
    )
    kernels.gather(image, log_odds, top, left, kernels.Patch(planes, odds, free))
    wide = colour.to_planes(image if channels == 3 else image[:, :, 0]).reshape(channels, 17, 29)
    wide, in_nats = np.pad(wide, ((0, 0), (50, 50), (50, 50))), np.pad(log_odds / 20.0, 50)
    box = (slice(50 + top, 50 + top + rows), slice(50 + left, 50 + left + columns))
    np.testing.assert_allclose(planes, wide[:, *box], atol=1e-3)
    np.testing.assert_allclose(odds, in_nats[box], atol=1e-6)
    np.testing.assert_array_equal(free, np.pad(np.ones((17, 29)), 50)[box])


@settings(max_examples=60, deadline=None)
@given(st.integers(-15, 15), st.integers(-15, 15))
def test_cover_takes_away_what_a_mask_covers(top, left):
    rng = np.random.default_rng(1)
    mask, free = rng.random((7, 9)).astype(F4), rng.random((11, 8)).astype(F4)
    wide = np.ones((60, 60))
    wide[20 + top : 27 + top, 20 + left : 29 + left] = 1 - mask
    expected = free * wide[20:31, 20:28]
    kernels.cover(free, top, left, mask)
    np.testing.assert_allclose(free, expected, rtol=1e-6)
