"""Mixtures of Gaussians and flat components against their values at points, on grids and in samples."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.core.gaussian_mixtures import MOST_COMPONENTS, NO_LABEL, GaussianMixtures
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

Array = NDArray[np.float64]

SEEDS = st.integers(0, 2**32 - 1)


def mixtures(
    seed: int, n_parts: int = 2, most: int = 4, flat: bool | None = None, spread: float = 20.0
) -> GaussianMixtures:
    """Random ones, with different numbers of components and, mostly, a flat one."""
    random = np.random.default_rng(seed)
    counts = random.integers(0 if flat is not False else 1, most + 1, n_parts)
    roots = [random.normal(0, 5, (count, 2, 2)) for count in counts]
    has_flat = random.random(n_parts) < 0.7 if flat is None else np.full(n_parts, flat)
    has_flat |= counts == 0
    return GaussianMixtures.of_parts(
        [random.normal(0, 2, count) for count in counts],
        [random.normal(0, spread, (count, 2)) for count in counts],
        [root @ root.swapaxes(1, 2) + 4 * np.eye(2) for root in roots],
        np.where(has_flat, random.normal(-6, 1, n_parts), -np.inf),
        [random.integers(0, 5, count) for count in counts],
    )


def log_masses_within(one: GaussianMixtures, area: float) -> Array:
    """Logs of the integrals, those of flat components over a region of `area` px^2."""
    return np.asarray(logsumexp(one.log_weights + np.where(one.flat, np.log(area), 0.0), axis=1))


def points(seed: int, n: int = 50, n_parts: int = 2) -> Array:
    return np.random.default_rng(seed).normal(0, 20, (n, n_parts, 2))


def grid(reach: float, step: float) -> tuple[Array, float]:
    """Points of a square `(n, 2, 2)`, the same for both parts, and their area."""
    along = np.arange(-reach, reach, step) + 0.5 * step
    places = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    return np.repeat(places[:, None], 2, axis=1), step**2


@given(SEEDS)
def test_product_is_that_of_the_values(seed: int) -> None:
    a, b, at = mixtures(seed), mixtures(seed + 1), points(seed)
    np.testing.assert_allclose((a * b).log_values(at), a.log_values(at) + b.log_values(at), rtol=1e-9)


def test_moments_are_those_on_a_grid() -> None:
    """Flat components over a square about the centre, summed with pixels of 0.5."""
    one, side = mixtures(3, flat=True, spread=5.0), 60.0
    mean, covariance = one.moments(side**2, (0.0, 0.0))
    places, area = grid(120, 0.5)
    weights = np.exp(one.log_values(places))
    flat = np.exp(np.where(one.flat, one.log_weights, -np.inf).max(axis=1))
    inside = (np.abs(places[:, :, 0]) < side / 2) & (np.abs(places[:, :, 1]) < side / 2)
    weights = weights - flat + flat * inside
    weights *= area / (weights.sum(axis=0) * area)
    expected = np.einsum("np,npx->px", weights, places)
    off = places - expected
    np.testing.assert_allclose(mean, expected, atol=1e-3)
    np.testing.assert_allclose(
        covariance, np.einsum("np,npx,npy->pxy", weights, off, off), rtol=1e-3, atol=0.1
    )


@given(SEEDS)
def test_overlaps_are_integrals_of_products(seed: int) -> None:
    """Of a product with one Gaussian, whose mass is known otherwise; and of only a flat component."""
    one = mixtures(seed)
    random = np.random.default_rng(seed + 7)
    means = random.normal(0, 20, (2, 5, 2))
    roots = random.normal(0, 5, (2, 5, 2, 2))
    covariances = roots @ roots.swapaxes(2, 3) + np.eye(2)
    overlaps = one.log_overlaps(means, covariances)
    assert overlaps.shape == (2, 5)
    for number in range(5):
        density = GaussianMixtures.of_parts(
            np.zeros((2, 1)), means[:, number, None], covariances[:, number, None]
        )
        np.testing.assert_allclose(overlaps[:, number], (one * density).log_masses, rtol=1e-9, atol=1e-9)
    flat = GaussianMixtures.of_parts([[], []], [[], []], [[], []], [0.5, -2.0])
    np.testing.assert_allclose(flat.log_overlaps(means, covariances), [[0.5] * 5, [-2.0] * 5])


@given(SEEDS)
def test_a_gaussian_stands_for_what_was_flat(seed: int) -> None:
    """As much of it as counts in the given area; nothing else changes."""
    one, at = mixtures(seed), points(seed)
    log_area = 11.0
    means, covariances = (
        np.array([[3.0, 1.0], [-9.0, 4.0]]),
        np.array([60.0, 90.0])[:, None, None] * np.eye(2),
    )
    proper = one.proper(log_area, means, covariances)
    assert not proper.flat.any()
    assert np.isfinite(proper.log_masses).all()
    flat = np.where(one.flat, one.log_weights, -np.inf)
    rest = replace(one, log_weights=np.where(one.flat, -np.inf, one.log_weights))
    for part in range(2):
        stand_in = multivariate_normal(means[part], covariances[part]).logpdf(at[:, part])
        expected = np.logaddexp(rest.log_values(at)[:, part], logsumexp(flat[part]) + log_area + stand_in)
        np.testing.assert_allclose(proper.log_values(at)[:, part], expected, rtol=1e-9)
        np.testing.assert_allclose(proper.log_masses[part], log_masses_within(one, np.exp(log_area))[part])
    np.testing.assert_array_equal(proper.labels, one.labels)


@given(SEEDS, st.floats(0.01, 0.99))
def test_blended_densities_are_the_mixture_of_both(seed: int, share: float) -> None:
    """Whatever their masses were."""
    a, b, at = mixtures(seed, flat=False), mixtures(seed + 1, flat=False), points(seed)
    blended = a.blended(b, share)
    np.testing.assert_allclose(blended.log_masses, 0.0, atol=1e-9)
    own, other = (each.log_values(at) - each.log_masses for each in (a, b))
    expected = np.logaddexp(np.log1p(-share) + own, np.log(share) + other)
    np.testing.assert_allclose(blended.log_values(at), expected, rtol=1e-9, atol=1e-9)
    assert blended.labels.shape == blended.log_weights.shape


def test_labels_survive_products() -> None:
    seen = GaussianMixtures.of_parts(
        [[0.0, 0.0]], [[[0.0, 0.0], [50.0, 0.0]]], [[np.eye(2)] * 2], [-3.0], [[7, 2]]
    )
    told = GaussianMixtures.of_parts([[0.0]], [[[1.0, 0.0]]], [[np.eye(2)]], [-9.0])
    for product in (seen * told, told * seen):
        by_label = {
            int(label): np.exp(product.log_weights[product.labels == label]).sum()
            for label in np.unique(product.labels[np.isfinite(product.log_weights)])
        }
        assert set(by_label) == {NO_LABEL, 2, 7}
        assert by_label[7] > 100 * by_label[2]


def test_long_products_keep_what_is_heavy_and_what_is_flat() -> None:
    random, count = np.random.default_rng(0), 12
    weights, means = random.normal(0, 1, (2, count)), random.normal(0, 10, (2, count, 2))
    one, two = (
        GaussianMixtures.of_parts([weights[k]], [means[k]], [np.tile(9 * np.eye(2), (count, 1, 1))], [-30.0])
        for k in range(2)
    )
    product = one * two
    assert product.log_weights.shape == (1, MOST_COMPONENTS)
    assert (product.flat & np.isfinite(product.log_weights)).sum() == 1
    overlaps = multivariate_normal(cov=18 * np.eye(2)).logpdf(means[0][:, None] - means[1])
    every = np.concatenate([(weights[0][:, None] + weights[1] + overlaps).ravel(), weights.ravel() - 30])
    kept = np.sort(product.log_weights[~product.flat & np.isfinite(product.log_weights)])
    np.testing.assert_allclose(kept, np.sort(every)[-len(kept) :], rtol=1e-9)
    assert len(kept) == MOST_COMPONENTS - 1


def test_a_part_that_nothing_is_said_of_needs_no_arrays() -> None:
    one = GaussianMixtures.of_parts([[], [0.0]], [[], np.ones((1, 2))], [[], np.eye(2)[None]], [0.0, -np.inf])
    np.testing.assert_array_equal(one.informative, [False, True])
    np.testing.assert_array_equal(one.log_masses, [np.inf, 0.0])
