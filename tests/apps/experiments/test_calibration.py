"""Stated probabilities beside what is so: exact statements lie on the diagonal, others do not."""

import numpy as np
import pytest
from rsmcm.apps.experiments.calibration import (
    ENOUGH,
    LEVELS,
    PRIOR,
    TRIED,
    TURN,
    Reliability,
    best_constants,
    reliability,
    wrong_by,
)
from scipy.spatial.transform import Rotation

N = 20_000
FAR = 5  # standard errors of a share: once in two million


def test_exact_probabilities_lie_on_the_diagonal() -> None:
    random = np.random.default_rng(1)
    stated = random.uniform(size=N)
    found = Reliability.of_probabilities(stated, random.uniform(size=N) < stated)
    expected, observed = found.rates
    assert np.all(np.abs(expected - observed) < FAR * np.sqrt(0.25 / found.count))
    doubted = Reliability.of_probabilities(stated, random.uniform(size=N) < stated**2)
    assert doubted.mean == pytest.approx(1 / 2 - 1 / 3, abs=FAR * np.sqrt(0.25 / N))


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_regions_of_true_covariances_lie_on_the_diagonal(dimension: int) -> None:
    squares = np.square(np.random.default_rng(2).standard_normal((N, dimension))).sum(axis=1)
    exact, sure = Reliability.of_regions(squares, dimension), Reliability.of_regions(4 * squares, dimension)
    assert exact.cases == sure.cases == N
    assert exact.worst < FAR * np.sqrt(0.25 / N)
    assert np.all(sure.so < exact.so)
    np.testing.assert_allclose(exact.stated / exact.count, LEVELS)


def test_what_is_not_claimed_is_unknown_and_no_error() -> None:
    right, claimed = np.array([True, False, True, False]), np.array([True, True, False, False])
    found = sum([Reliability.of_claims(right, claimed)] * ENOUGH, Reliability.nothing())
    assert (found.cases, found.unknown) == (2 * ENOUGH, 2 * ENOUGH)
    assert found.worst == found.mean == 0.5


def test_rotations_are_compared_whatever_the_axes_of_the_world() -> None:
    random = np.random.default_rng(3)
    true, world = Rotation.random(9, random), Rotation.random(rng=random)
    angles = np.zeros(9)
    angles[[2, 5]] = 2 * TURN, TURN / 2
    found = Rotation.from_rotvec(np.radians(angles)[:, None] * [0, 0, 1]) * true * world
    np.testing.assert_allclose(wrong_by(found.as_matrix(), true.as_matrix()), angles, atol=1e-6)


def test_constants_are_found_with_which_statements_were_made() -> None:
    random = np.random.default_rng(6)
    apart, nats = random.uniform(0, 1.2, (N, 1, 2)), random.uniform(-1.5, 1.5, (N, 1, 2))
    shared = random.uniform(0, 1, (N, 1, 1))
    for true in ((2.0, 7.0), (4.0, 4.0)):
        shown = 1 / (1 + np.exp(-PRIOR - true[1] * nats))
        stated = np.exp(-true[0] * apart**2) * shown * (1 - 0.5 * shared * shown[..., ::-1])
        right = random.uniform(size=(N, 2)) < stated[:, 0]
        made = {each: [reliability(each, (apart, shared, nats, right))] for each in TRIED}
        np.testing.assert_allclose(best_constants(made, [0]), true, atol=1)
