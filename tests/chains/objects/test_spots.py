"""Foreground that nobody explains, against plain numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from rsmcm.chains.objects import blob_records as kernels

F4 = np.float32

masks = arrays.arrays(
    F4,
    st.tuples(st.integers(1, 14), st.integers(1, 18)),
    elements=st.sampled_from([0.0, 0.1, 0.3, 0.9]),
    fill=st.just(F4(0)),
)


@pytest.mark.parametrize("size", [(40, 60), (7, 5), (33, 65)])
@pytest.mark.parametrize("scale", [1, 4])
def test_count_foreground(size, scale):
    log_odds = np.random.default_rng(5).integers(-20, 127, size).astype(np.int8)
    counts = np.full((-(-size[0] // scale), -(-size[1] // scale)), 7, np.int32)
    kernels.count_foreground(log_odds.reshape(-1), size[1], scale, counts, np.empty(200, np.int64))
    wide = np.zeros((counts.shape[0] * scale, counts.shape[1] * scale), bool)
    wide[: size[0], : size[1]] = log_odds < 0
    expected = wide.reshape(counts.shape[0], scale, counts.shape[1], scale).sum(axis=(1, 3))
    np.testing.assert_array_equal(counts, expected)


@settings(max_examples=150, deadline=None)
@given(masks, st.integers(-20, 30), st.integers(-20, 40), st.integers(1, 5))
def test_clear_blocks(mask, top, left, scale):
    counts = np.random.default_rng(0).integers(1, 9, (7, 9)).astype(np.int32)
    expected = counts.copy()
    for row, column in np.argwhere(mask > 0.2):
        y, x = (top + row) // scale, (left + column) // scale
        if 0 <= y < 7 and 0 <= x < 9:
            expected[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2] = 0
    kernels.clear_blocks(counts, top, left, mask, scale, np.empty(18, F4))
    np.testing.assert_array_equal(counts, expected)
