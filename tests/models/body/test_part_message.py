"""Joint hypotheses of head and hands: against sums over all of them, one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.body.image_features import BodyImage
from rsmcm.models.body.parts import MOST_HYPOTHESES, PartMessage
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

Array = NDArray[np.float64]

SEEDS = st.integers(0, 2**32 - 1)


def mixtures(random: np.random.Generator, flat: float = -np.inf) -> GaussianMixtures:
    """Of head and hands, one or two Gaussians each."""
    counts = random.integers(1, 3, 3)
    roots = [random.normal(0, 8, (count, 2, 2)) for count in counts]
    return GaussianMixtures.of_parts(
        [random.normal(0, 1, count) for count in counts],
        [random.normal(0, 10, (count, 2)) for count in counts],
        [root @ root.swapaxes(1, 2) + 4 * np.eye(2) for root in roots],
        np.full(3, flat),
    )


def hypotheses_of(said: PartMessage) -> list[GaussianMixtures]:
    rows = np.arange(said.stacked.n_parts).reshape(-1, 3)
    return [said.stacked.take(row) for row in rows]


def message(random: np.random.Generator, n_hypotheses: int) -> PartMessage:
    hypotheses = [mixtures(random) for _ in range(n_hypotheses)]
    return PartMessage(GaussianMixtures.stacked(hypotheses), None, random.normal(0, 1, n_hypotheses))


def of_image(said: GaussianMixtures) -> PartMessage:
    flat = np.zeros((20, 20), np.float32)
    image = BodyImage(flat.shape, None, None, flat, flat, np.zeros((0, 2)), np.zeros(0), said)
    return PartMessage(GaussianMixtures.uniform(3), image)


def mixtures_of(message: PartMessage) -> GaussianMixtures:
    assert message.image is not None
    return message.image.mixtures


def value(said: GaussianMixtures, part: int, place: Array) -> float:
    """Of one part's mixture."""
    total = 0.0
    for weight, mean, covariance, flat in zip(
        said.log_weights[part], said.means[part], said.covariances[part], said.flat[part], strict=True
    ):
        density = 1.0 if flat else multivariate_normal.pdf(place, mean, covariance)
        total += np.exp(weight) * density
    return total


def brute_force(said: PartMessage, places: Array) -> float:
    """p(F) as its definition has it."""
    return sum(
        np.exp(weight) * np.prod([value(each, part, places[part]) for part in range(3)])
        for weight, each in zip(said.log_hypotheses, hypotheses_of(said), strict=True)
    )


@given(SEEDS, st.integers(1, 4))
@settings(max_examples=10, deadline=None)
def test_values_are_sums_over_hypotheses(seed: int, n_hypotheses: int) -> None:
    random = np.random.default_rng(seed)
    said, places = message(random, n_hypotheses), random.normal(0, 10, (5, 3, 2))
    np.testing.assert_allclose(
        np.exp(said.log_values(places)), [brute_force(said, each) for each in places], rtol=1e-6
    )


@given(SEEDS, st.integers(1, 4), st.integers(1, 4))
@settings(max_examples=10, deadline=None)
def test_products_are_products_of_values_and_commute(seed: int, n_ours: int, n_theirs: int) -> None:
    random = np.random.default_rng(seed)
    ours, theirs = message(random, n_ours), message(random, n_theirs)
    places = random.normal(0, 10, (7, 3, 2))
    product = ours * theirs
    assert len(hypotheses_of(product)) == n_ours * n_theirs
    np.testing.assert_allclose(
        product.log_values(places), ours.log_values(places) + theirs.log_values(places), rtol=1e-9
    )
    np.testing.assert_allclose((theirs * ours).log_values(places), product.log_values(places), rtol=1e-9)
    assert (theirs * ours).log_mass == pytest.approx(product.log_mass, abs=1e-9)


def test_of_many_combinations_the_heaviest_are_kept() -> None:
    random = np.random.default_rng(0)
    ours, theirs = message(random, 6), message(random, 7)
    product = ours * theirs
    masses = [
        PartMessage(one, None, np.array([a])) * PartMessage(other, None, np.array([b]))
        for one, a in zip(hypotheses_of(ours), ours.log_hypotheses, strict=True)
        for other, b in zip(hypotheses_of(theirs), theirs.log_hypotheses, strict=True)
    ]
    expected = sorted((each.log_mass for each in masses), reverse=True)[:MOST_HYPOTHESES]
    assert len(hypotheses_of(product)) == MOST_HYPOTHESES == len(expected)
    assert product.log_mass == pytest.approx(logsumexp(expected), abs=1e-9)


def test_masses_and_marginals_are_sums_over_hypotheses() -> None:
    """A hypothesis counts in the marginal of a part by its weight and the masses of its other parts."""
    random = np.random.default_rng(1)
    said, image = message(random, 3), of_image(mixtures(random, flat=-4.0))
    for one in (said, said * image):
        each = [h if one is said else h * mixtures_of(image) for h in hypotheses_of(said)]
        masses = np.array([h.log_masses for h in each])
        assert one.log_mass == pytest.approx(logsumexp(masses.sum(axis=1) + said.log_hypotheses), abs=1e-9)
        for place in random.normal(0, 10, (4, 2)):
            for part in range(3):
                others = masses.sum(axis=1) - masses[:, part] + said.log_hypotheses
                expected = sum(np.exp(w) * value(h, part, place) for w, h in zip(others, each, strict=True))
                assert value(one.mixtures, part, place) == pytest.approx(expected, rel=1e-6)
    np.testing.assert_array_equal(said.predicted.means, said.mixtures.means)
