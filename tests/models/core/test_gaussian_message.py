"""Products of Gaussians by identity against dense Gaussians over all numbers of all things together."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.core.gaussian_message import GaussianMessage
from scipy.stats import multivariate_normal

UNIFORM = GaussianMessage.uniform(4)


def random_moments(
    random: np.random.Generator, n_objects: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Boxes somewhere in a picture, uncertain by 1 to 20 px with correlations."""
    means = random.uniform(0, 500, (n_objects, 4))
    roots = random.normal(size=(n_objects, 4, 4)) * random.uniform(1, 20, (n_objects, 4, 1))
    return means, roots @ roots.transpose(0, 2, 1) + np.eye(4)


@st.composite
def densities(draw: st.DrawFn) -> GaussianMessage:
    identities = draw(st.lists(st.integers(1, 6), unique=True, max_size=4))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    return GaussianMessage.from_moments(identities, *random_moments(random, len(identities)))


def close(one: GaussianMessage, other: GaussianMessage) -> None:
    """Equal but for the order of additions."""
    np.testing.assert_array_equal(one.identities, other.identities)
    np.testing.assert_allclose(one.information, other.information, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(one.vector, other.vector, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(one.log_scale, other.log_scale, rtol=1e-12, atol=1e-9)


def log_overlap(identity: int, messages: list[GaussianMessage]) -> float:
    """Integral of a product of densities: that of all means, seen as draws around one unknown box.

    Subtracting the first box leaves a joint Gaussian of the differences, whose covariance has the first
    one's in every block and the others' on the diagonal.
    """
    moments = [message.marginal(identity) for message in messages if identity in message.identities]
    if len(moments) < 2:
        return 0.0
    (first, shared), rest = moments[0], moments[1:]
    covariance = np.kron(np.ones((len(rest), len(rest))), shared)
    for place, (_, own) in enumerate(rest):
        covariance[4 * place : 4 * place + 4, 4 * place : 4 * place + 4] += own
    differences = np.concatenate([mean - first for mean, _ in rest])
    return float(multivariate_normal(cov=covariance).logpdf(differences))


@given(st.lists(densities(), min_size=1, max_size=3))
def test_mass_and_marginals_equal_dense_gaussians(messages: list[GaussianMessage]) -> None:
    product = UNIFORM
    for message in messages:
        product = product * message
    expected = sum(log_overlap(int(identity), messages) for identity in product.identities)
    assert product.log_mass == pytest.approx(expected, rel=1e-7, abs=1e-6)  # quadratics of 1e5 cancel
    for identity in product.identities:
        known = [message.marginal(identity) for message in messages if identity in message.identities]
        precision = sum(np.linalg.inv(covariance) for _, covariance in known)
        weighted = sum(np.linalg.solve(covariance, mean) for mean, covariance in known)
        mean, covariance = product.marginal(int(identity))
        np.testing.assert_allclose(covariance, np.linalg.inv(precision), rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(mean, np.linalg.solve(precision, weighted), rtol=1e-7, atol=1e-6)


@given(densities(), densities(), densities())
def test_product_is_commutative_and_associative_and_uniform_is_neutral(
    one: GaussianMessage, two: GaussianMessage, three: GaussianMessage
) -> None:
    close(one * two, two * one)
    close((one * two) * three, one * (two * three))
    close(one * UNIFORM, one)
    close(UNIFORM * one, one)


@given(densities())
def test_densities_integrate_to_one_in_any_order_of_objects(message: GaussianMessage) -> None:
    assert message.log_mass == pytest.approx(0, abs=1e-6)
    identities, means, covariances = message.moments
    close(message, message * UNIFORM)
    again = GaussianMessage.from_moments(identities[::-1], means[::-1], covariances[::-1])
    np.testing.assert_array_equal(again.identities, identities)
    np.testing.assert_allclose(again.moments[1], means, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(again.moments[2], covariances, rtol=1e-6, atol=1e-8)


def test_value_at_a_box_is_the_density() -> None:
    random = np.random.default_rng(3)
    means, covariances = random_moments(random, 1)
    message = GaussianMessage.from_moments([7], means, covariances)
    for box in random.multivariate_normal(means[0], covariances[0], 5):
        value = message.log_scale[0] + message.vector[0] @ box - 0.5 * box @ message.information[0] @ box
        expected = multivariate_normal(means[0], covariances[0]).logpdf(box)
        assert value == pytest.approx(expected, abs=1e-8)


def test_objects_without_enough_information() -> None:
    direction = np.array([0.0, -0.3, 0.0, 1.0])
    height_only = GaussianMessage(
        np.array([2]), np.outer(direction, direction)[None], np.zeros((1, 4)), np.zeros(1)
    )
    nothing = GaussianMessage(np.array([3]), np.zeros((1, 4, 4)), np.zeros((1, 4)), np.array([0.5]))
    known = GaussianMessage.from_moments([1, 2], *random_moments(np.random.default_rng(0), 2))
    for message, identity in ((height_only, 2), (nothing, 3), (known, 3), (UNIFORM, 1)):
        with pytest.raises(KeyError, match=f"{identity}: not mentioned"):
            message.marginal(identity)
    assert height_only.log_mass == np.inf
    assert nothing.log_mass == 0.5
    assert UNIFORM.log_mass == 0.0
    product = known * height_only * nothing
    np.testing.assert_array_equal(product.proper, [True, True, False])
    np.testing.assert_array_equal(product.moments[0], [1, 2])
    assert np.isfinite(product.log_mass)


@pytest.mark.parametrize(
    ("identities", "means", "covariances", "says"),
    [
        ([1], np.zeros((2, 4)), np.eye(4)[None], r"means: got \(2, 4\)"),
        ([1, 2], np.zeros((2, 4)), np.eye(4), r"covariances: got \(4, 4\)"),
        ([1, 1], np.zeros((2, 4)), np.stack([np.eye(4)] * 2), "got 1 twice"),
        ([1], np.zeros((1, 4)), -np.eye(4)[None], "positive definite"),
    ],
)
def test_bad_moments(
    identities: list[int], means: NDArray[np.float64], covariances: NDArray[np.float64], says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        GaussianMessage.from_moments(identities, means, covariances)
