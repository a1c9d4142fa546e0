"""Sums of exponentials against scipy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.models.core.gaussian_mixtures import log_sums
from scipy.special import logsumexp


@given(st.integers(0, 10**6), st.sampled_from([0, 1, 2, -1]))
def test_sums_are_those_of_scipy(seed: int, axis: int) -> None:
    """Of numbers far apart, some of which are infinite."""
    random = np.random.default_rng(seed)
    values = random.normal(0, 300, (4, 3, 5))
    values[random.random(values.shape) < 0.3] = -np.inf
    values[random.random(values.shape) < 0.02] = np.inf
    np.testing.assert_allclose(log_sums(values, axis), logsumexp(values, axis=axis), rtol=1e-12)
