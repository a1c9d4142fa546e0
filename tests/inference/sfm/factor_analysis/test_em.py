"""EM of factor analysis beside a plain version with loops, and what it must never do."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.inference.optimisation import Anderson
from rsmcm.inference.sfm.factor_analysis.em import Posterior, expectation_maximisation
from rsmcm.inference.sfm.factor_analysis.factorisation import around_start
from rsmcm.inference.sfm.factor_analysis.initialisation import mean_filled
from rsmcm.inference.sfm.factor_analysis.kernels import invert_information
from rsmcm.inference.sfm.factor_analysis.observations import Observations

from ....support.turning import turning

Numbers = NDArray[np.float64]


def problem(
    missing: float, *, equal: bool = False, coherent: bool = False, noise: float = 2.0
) -> tuple[Observations, Posterior]:
    """Turning points with gaps and unequal weights, and the published start."""
    generator = np.random.default_rng(7)
    positions, _, _ = turning(n_frames=9, n_points=14, noise=noise)
    weights = np.ones(positions.shape[:2]) if equal else generator.uniform(0.3, 3, positions.shape[:2])
    weights[generator.random(weights.shape) < missing] = 0
    observations = Observations.from_arrays(positions, weights)
    cameras, shape = mean_filled(observations)
    frames, points = np.ones(9, bool), np.ones(14, bool)
    return observations, around_start(observations, cameras, shape, frames, points, coherent=coherent)


def listed(observations: Observations) -> list[tuple[int, int, Numbers, float]]:
    """Frame, point, position and weight of every observation."""
    by_frame = observations.by_frame
    return [
        (int(t), int(i), np.array([x, y]), float(w))
        for t, i, x, y, w in zip(
            by_frame.own, by_frame.other, by_frame.x, by_frame.y, by_frame.weight, strict=True
        )
    ]


def plain_iteration(observations: Observations, start: Posterior) -> tuple[Posterior, float]:
    """One iteration of independent frames, with loops; and the bound, summed term by term."""
    seen, noise = listed(observations), start.noise
    n_frames, n_points = observations.n_frames, observations.n_points
    second = np.zeros((n_points, 4, 4))
    for i in range(n_points):
        s = np.append(start.shape[i], 1)
        second[i] = np.outer(s, s)
        second[i, :3, :3] += start.shape_covariance[i]
    information, vector = np.zeros((n_frames, 4, 4)), np.zeros((n_frames, 4, 2))
    for t, i, where, w in seen:
        information[t] += w * second[i]
        vector[t] += w * np.outer(np.append(start.shape[i], 1), where)

    def e_step(variance: Numbers) -> tuple[Numbers, Numbers]:
        covariance = np.linalg.inv(information / noise + np.diag(1 / variance))
        return (covariance @ vector / noise).transpose(0, 2, 1), covariance

    cameras, covariance = e_step(start.prior.numbers)
    squares = np.einsum("tcj->j", cameras**2) + 2 * np.einsum("tjj->j", covariance)
    learned = np.array([squares[:3].sum() / (6 * n_frames), squares[3] / (2 * n_frames)])
    variance = np.repeat(learned, (3, 1))
    cameras, covariance = e_step(variance)

    bound = 0.0
    for t, i, where, w in seen:
        expected = where @ where - 2 * where @ cameras[t] @ np.append(start.shape[i], 1)
        moment = cameras[t].T @ cameras[t] + 2 * covariance[t]
        expected += np.trace(moment @ second[i])
        bound += -np.log(2 * np.pi * noise / w) - 0.5 * w * expected / noise
    for t in range(n_frames):
        for row in cameras[t]:
            bound -= 0.5 * (np.sum((np.diag(covariance[t]) + row**2) / variance) - 4)
            bound -= 0.5 * (np.log(variance).sum() - np.linalg.slogdet(covariance[t])[1])
    for i in range(n_points):
        moment = start.shape_covariance[i] + np.outer(start.shape[i], start.shape[i])
        bound -= 0.5 * (np.trace(moment) - 3 - np.linalg.slogdet(start.shape_covariance[i])[1])

    shape, spread, error = np.zeros((n_points, 3)), np.zeros((n_points, 3, 3)), 0.0
    for i in range(n_points):
        whole, pull, rest = np.zeros((3, 3)), np.zeros(3), 0.0
        for t, point, where, w in seen:
            if point == i:
                moment = cameras[t].T @ cameras[t] + 2 * covariance[t]
                whole += w * moment[:3, :3]
                pull += w * (cameras[t, :, :3].T @ where - moment[:3, 3])
                rest += w * (where @ where - 2 * where @ cameras[t, :, 3] + moment[3, 3])
        spread[i] = np.linalg.inv(whole / noise + np.eye(3))
        shape[i] = spread[i] @ pull / noise
        error += rest - 2 * pull @ shape[i] + np.trace(whole @ (spread[i] + np.outer(shape[i], shape[i])))
    noise = error / (2 * len(seen))
    return Posterior(cameras, covariance, shape, spread, noise, start.prior), bound


@pytest.mark.parametrize(("missing", "equal"), [(0.5, False), (0.2, False), (0.0, False), (0.0, True)])
def test_one_iteration_equals_the_plain_version(missing: float, equal: bool) -> None:
    """Lists, full matrices, and full matrices with one weight are three ways through the code."""
    observations, start = problem(missing, equal=equal)
    expected, bound = plain_iteration(observations, start)
    found, history = expectation_maximisation(observations, start, iterations=1, tolerance=0.0)
    for name in ("cameras", "camera_covariance", "shape", "shape_covariance", "noise"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-10, atol=1e-12)
    assert history[0] == pytest.approx(bound, rel=1e-10)


@pytest.mark.parametrize("accelerate", [False, True])
@pytest.mark.parametrize("coherent", [False, True])
def test_the_bound_never_falls(coherent: bool, accelerate: bool) -> None:
    observations, start = problem(0.4, coherent=coherent)
    _, history = expectation_maximisation(
        observations, start, iterations=60, tolerance=-np.inf, accelerate=accelerate
    )
    assert (np.diff(history) >= -1e-9 * np.abs(history[:-1])).all()


def test_anderson_solves_linear_equations_in_as_many_steps_as_there_are_numbers() -> None:
    generator = np.random.default_rng(0)
    matrix = 0.9 * np.linalg.qr(generator.normal(size=(4, 4)))[0]
    goal, place = generator.normal(size=4), np.zeros(4)
    acceleration = Anderson()
    for _ in range(6):
        place = acceleration.propose(place, matrix @ (place - goal) + goal)
    np.testing.assert_allclose(place, goal, atol=1e-6)


def test_noise_free_observations_are_explained_to_rounding() -> None:
    observations, start = problem(0.3, noise=0.0)
    found, _ = expectation_maximisation(observations, start, iterations=1000, tolerance=-np.inf)
    assert np.sqrt(found.noise) < 1e-4


def test_a_loop_is_compiled_once_for_films_of_any_kind() -> None:
    """Points seen throughout, in gaps, and frames of one normal matrix come as arrays of one layout."""
    before = set(invert_information.signatures)  # type: ignore[attr-defined]
    for missing, equal in ((0.0, True), (0.0, False), (0.5, False)):
        for coherent in (False, True):
            observations, start = problem(missing, equal=equal, coherent=coherent)
            expectation_maximisation(observations, start, iterations=2, tolerance=0.0)
    assert len(set(invert_information.signatures) - before) <= 1  # type: ignore[attr-defined]
