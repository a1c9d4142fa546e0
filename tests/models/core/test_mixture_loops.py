"""Compiled values and products of mixtures against the same formulas in plain numpy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures
from scipy.special import logsumexp

Array = NDArray[np.float64]

SEEDS = st.integers(0, 2**32 - 1)


def mixtures(seed: int, most: int) -> GaussianMixtures:
    """Of three parts, with fillers; the first has a flat component, the others mostly."""
    random = np.random.default_rng(seed)
    counts = random.integers(1, most + 1, 3)
    roots = [random.normal(0, 5, (count, 2, 2)) for count in counts]
    return GaussianMixtures.of_parts(
        [random.normal(0, 2, count) for count in counts],
        [random.normal(300, 100, (count, 2)) for count in counts],
        [root @ root.swapaxes(1, 2) + 4 * np.eye(2) for root in roots],
        np.where(random.random(3) < [1, 0.7, 0.7], random.normal(-12, 1, 3), -np.inf),
        [random.integers(0, 5, count) for count in counts],
    )


def plain_log_density(steps: Array, covariances: Array) -> Array:
    inverse = np.linalg.inv(covariances)
    square = np.einsum("...x,...xy,...y->...", steps, inverse, steps)
    return np.asarray(-np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(covariances)[1] - 0.5 * square)


def plain_values(one: GaussianMixtures, points: Array) -> Array:
    density = plain_log_density(points[:, :, None] - one.means, one.covariances)
    return np.asarray(logsumexp(one.log_weights + np.where(one.flat, 0.0, density), axis=2))


@given(SEEDS)
def test_values_are_those_of_plain_arrays(seed: int) -> None:
    one = mixtures(seed, 45)
    points = np.random.default_rng(seed).normal(300, 150, (40, 3, 2))
    np.testing.assert_allclose(one.log_values(points), plain_values(one, points), rtol=1e-11, atol=1e-12)


def test_a_part_without_any_weight_is_minus_infinity() -> None:
    one = GaussianMixtures.of_parts([[], [0.0]], [[], np.zeros((1, 2))], [[], np.eye(2)[None]])
    values = one.log_values(np.zeros((4, 2, 2)))
    np.testing.assert_array_equal(values[:, 0], -np.inf)
    np.testing.assert_allclose(values[:, 1], -np.log(2 * np.pi), rtol=1e-14)
    assert one.log_values(np.zeros((0, 2, 2))).shape == (0, 2)


@given(SEEDS)
def test_products_are_those_of_plain_arrays(seed: int) -> None:
    a, b = mixtures(seed, 4), mixtures(seed + 1, 4)
    product = a * b  # few enough that nothing is left out
    left, right = a.covariances[:, :, None], b.covariances[:, None]
    both = ~a.flat[:, :, None] & ~b.flat[:, None]
    only = a.flat[:, :, None] & ~b.flat[:, None]
    share, step = left @ np.linalg.inv(left + right), b.means[:, None] - a.means[:, :, None]
    means = a.means[:, :, None] + (share @ step[..., None])[..., 0]
    means = np.where(both[..., None], means, np.where(only[..., None], b.means[:, None], a.means[:, :, None]))
    covariances = np.where(only[..., None, None], right, np.broadcast_to(left, share.shape))
    covariances = np.where(both[..., None, None], share @ right, covariances)
    weights = a.log_weights[:, :, None] + b.log_weights[:, None]
    weights = weights + np.where(both, plain_log_density(step, left + right), 0.0)
    np.testing.assert_allclose(product.log_weights, weights.reshape(3, -1), rtol=1e-11, atol=1e-12)
    kept = np.isfinite(product.log_weights) & ~product.flat
    np.testing.assert_allclose(product.means[kept], means.reshape(3, -1, 2)[kept], rtol=1e-10)
    np.testing.assert_allclose(
        product.covariances[kept], covariances.reshape(3, -1, 2, 2)[kept], rtol=1e-9, atol=1e-10
    )
