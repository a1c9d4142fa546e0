"""Damped steps of many experts against numpy: what is taken, what is tried next, and where that is."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rsmcm.chains.face import kernels as newton
from rsmcm.models.face.morphable_model import Poses

from ...support.surfaces import poses_near

Array = NDArray[np.float64]

N, D = 5, 8


def parts(poses: Poses) -> newton.PoseArrays:
    return newton.PoseArrays(poses.rotations.copy(), poses.translations.copy(), poses.morphs.copy())


class Case(NamedTuple):
    """Experts at poses, and what they believe there."""

    poses: Poses
    prior: Poses
    precision: Array
    belief: newton.Objective
    climb: newton.SearchState


def case(seed: int) -> Case:
    random = np.random.default_rng(seed)
    poses, prior = poses_near(N, D - 5, seed), poses_near(N, D - 5, seed)
    prior = prior.moved(0.1 * random.normal(size=(N, D)))
    roots = random.normal(size=(N, D, 2 * D))
    rows = np.zeros((N, 7, 2, 16), np.float32)
    rows[..., :D] = random.normal(size=(N, 7, 2, D))
    belief = newton.Objective(
        random.uniform(1, 2, N),
        random.normal(size=(N, D)),
        roots @ np.swapaxes(roots, 1, 2),
        np.ones(N, bool),
        rows,
    )
    climb = newton.SearchState(
        parts(poses),
        np.full(N, np.inf),
        np.zeros((N, D)),
        np.zeros((N, D, D)),
        np.empty_like(rows),
        np.full(N, 0.1),
    )
    return Case(poses, prior, random.uniform(0.5, 2, D), belief, climb)


def advanced(one: Case, pace: newton.StepLimits) -> tuple[NDArray[np.int64], Poses]:
    going, following = np.empty(N, np.int64), parts(one.poses)
    n = newton.advance(
        np.arange(N),
        parts(one.poses),
        one.belief,
        parts(one.prior),
        one.precision,
        one.climb,
        pace,
        going,
        following,
    )
    return going[:n], Poses(*(part[:n] for part in following))


def test_the_first_evaluation_is_accepted_and_the_step_is_levenbergs() -> None:
    one = case(0)
    going, following = advanced(one, newton.StepLimits(1e9, 0.0, first=True))
    change = one.poses.changes_from(one.prior)
    energy = one.belief.energy + 0.5 * (change**2 * one.precision).sum(axis=1)
    gradient = one.belief.gradient + change * one.precision
    curvature = one.belief.curvature + np.diag(one.precision)
    np.testing.assert_allclose(one.climb.energy, energy, rtol=1e-9)
    np.testing.assert_allclose(one.climb.gradient, gradient, atol=1e-9)
    np.testing.assert_allclose(one.climb.curvature, curvature, rtol=1e-12)
    damped = curvature + 0.1 * np.einsum("nij,ij->nij", curvature, np.eye(D))
    step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
    wanted = one.poses.moved(step)
    np.testing.assert_array_equal(going, np.arange(N))
    for found, right in zip(parts(following), parts(wanted), strict=True):
        np.testing.assert_allclose(found, right, atol=1e-9)


def test_steps_are_capped_and_end_where_they_are_short() -> None:
    one = case(3)
    _, far = advanced(one, newton.StepLimits(1e9, 0.0, first=True))
    step = far.changes_from(one.poses)
    moves = np.einsum("nvad,nd->nva", one.belief.rows[..., :D], step)
    longest = np.sqrt((moves**2).sum(axis=2).max(axis=1))
    bound = float(np.sort(longest)[2] * 1.001)
    _, capped = advanced(one, newton.StepLimits(bound, 0.0, first=True))
    share = np.minimum(1, bound / longest)
    np.testing.assert_allclose(capped.changes_from(one.poses), share[:, None] * step, atol=1e-5)
    going, _ = advanced(one, newton.StepLimits(1e9, bound, first=True))
    np.testing.assert_array_equal(going, np.flatnonzero(longest > bound))


def test_only_better_poses_are_taken() -> None:
    one = case(4)
    advanced(one, newton.StepLimits(1e9, 0.0, first=True))
    one.climb.damping[:] = 0.1
    before = one.climb.poses.translations.copy()
    one.climb.energy[:2] -= 1.0  # where they are is better than what is tried
    one.climb.energy[2:] += 1.0
    moved = one._replace(poses=Poses(one.poses.rotations, one.poses.translations + 0.01, one.poses.morphs))
    moved.belief.energy[:] -= 0.5
    advanced(moved, newton.StepLimits(1e9, 0.0, first=False))
    np.testing.assert_allclose(one.climb.damping, [1.0, 1.0, 0.03, 0.03, 0.03])
    np.testing.assert_array_equal(one.climb.poses.translations[:2], before[:2])
    np.testing.assert_array_equal(one.climb.poses.translations[2:], before[2:] + 0.01)
