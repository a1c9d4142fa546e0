"""Bundle adjustment against finite differences, a dense solution, scipy's least squares, and the truth."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.inference.sfm.factor_analysis.observations import SparseObservations
from rsmcm.inference.sfm.perspective.bundle_adjustment import (
    Bundle,
    about,
    adjust,
    normal_equations,
    reduced,
    retriangulated,
    squares_of,
)
from rsmcm.models.camera.perspective_camera import PerspectiveCameras
from rsmcm.models.numerics.rotations import exponential
from scipy.optimize import least_squares

from ....support.perspective_films import PerspectiveFilm, table_top, turning

Numbers = NDArray[np.float64]


def listed_of(film: PerspectiveFilm) -> SparseObservations:
    frames, points = np.nonzero(film.weights)
    x, y = film.tracks[frames, points].T.copy()
    by_frame = SparseObservations.sorted_by(frames, len(film.tracks), points, x, y, np.ones(len(x)))
    return about(by_frame.transposed(film.tracks.shape[1]), film.cameras.principal)


def moved(cameras: PerspectiveCameras, shape: Numbers, step: Numbers) -> tuple[PerspectiveCameras, Numbers]:
    """Cameras and points after a step in all unknowns: six of each camera, 1 / focal length, points."""
    n = 6 * len(cameras.scales)
    by_camera = step[:n].reshape(-1, 6)
    return replace(
        cameras,
        rotations=exponential(by_camera[:, :3]) @ cameras.rotations,
        scales=cameras.scales * np.exp(by_camera[:, 3]),
        shifts=cameras.shifts + by_camera[:, 4:],
        curvature=cameras.curvature + step[n],
    ), shape + step[n + 1 :].reshape(-1, 3)


def residuals(listed: SparseObservations, cameras: PerspectiveCameras, shape: Numbers) -> Numbers:
    places, _ = replace(cameras, principal=np.zeros(2)).seen(shape)
    seen = places[listed.other, listed.own]
    return np.concatenate([listed.x - seen[:, 0], listed.y - seen[:, 1]])


def dense_jacobian(listed: SparseObservations, cameras: PerspectiveCameras, shape: Numbers) -> Numbers:
    """Of the predicted positions, by central differences."""
    size = 6 * len(cameras.scales) + 1 + shape.size
    scale = np.full(size, 1e-5)
    scale[6 * len(cameras.scales)] = 1e-8
    columns = [
        -(residuals(listed, *moved(cameras, shape, step)) - residuals(listed, *moved(cameras, shape, -step)))
        / (2 * step.sum())
        for step in np.diag(scale)
    ]
    return np.stack(columns, axis=1)


@pytest.fixture(scope="module")
def small() -> PerspectiveFilm:
    return table_top(3, n_points=14, n_frames=6, missing=0.3)


def test_normal_equations_are_those_of_finite_differences(small: PerspectiveFilm) -> None:
    listed = listed_of(small)
    weights = np.random.default_rng(0).uniform(0.5, 2, len(listed.x))
    equations = normal_equations(listed, weights, small.cameras, small.shape)
    jacobian = dense_jacobian(listed, small.cameras, small.shape)
    twice = np.concatenate([weights, weights])
    whole = jacobian.T @ (twice[:, None] * jacobian)
    vector = jacobian.T @ (twice * residuals(listed, small.cameras, small.shape))
    n = 6 * len(small.cameras.scales)

    def assert_same(found: Numbers, wanted: Numbers) -> None:
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())

    for t in range(len(small.cameras.scales)):
        assert_same(equations.cameras[t], whole[6 * t : 6 * t + 6, 6 * t : 6 * t + 6])
    assert_same(equations.border.reshape(-1), whole[n, :n])
    assert_same(np.array(equations.corner), whole[n, n])
    assert_same(equations.points[4], whole[n + 13 : n + 16, n + 13 : n + 16])
    assert_same(equations.mixed_border.reshape(-1), whole[n, n + 1 :])
    for k in range(len(listed.x)):
        i, t = listed.own[k], listed.other[k]
        assert_same(equations.mixed[k], whole[n + 1 + 3 * i : n + 4 + 3 * i, 6 * t : 6 * t + 6])
    assert_same(
        np.concatenate(
            [
                equations.camera_vector.reshape(-1),
                [equations.corner_vector],
                equations.point_vector.reshape(-1),
            ]
        ),
        vector,
    )


@pytest.mark.parametrize("focal_known", [False, True])
def test_elimination_leaves_the_schur_complement(small: PerspectiveFilm, focal_known: bool) -> None:
    listed = listed_of(small)
    equations = normal_equations(listed, np.ones(len(listed.x)), small.cameras, small.shape)
    matrix, vector, _ = reduced(listed, equations, 0.0, focal_known=focal_known)
    jacobian = dense_jacobian(listed, small.cameras, small.shape)
    n = 6 * len(small.cameras.scales) + (not focal_known)
    kept = np.r_[:n, 6 * len(small.cameras.scales) + 1 : jacobian.shape[1]]
    whole = jacobian.T @ jacobian
    pull = jacobian.T @ residuals(listed, small.cameras, small.shape)
    whole, pull = whole[np.ix_(kept, kept)], pull[kept]
    gain = whole[:n, n:] @ np.linalg.inv(whole[n:, n:])
    wanted = whole[:n, :n] - gain @ whole[n:, :n]
    np.testing.assert_allclose(np.tril(matrix[:n, :n]), np.tril(wanted), atol=1e-6 * np.abs(wanted).max())
    wanted = pull[:n] - gain @ pull[n:]
    np.testing.assert_allclose(vector[:n], wanted, atol=1e-6 * np.abs(wanted).max())


def test_optimum_is_that_of_scipy() -> None:
    """Under the noise that was found: scipy's squares are those of errors that outliers lengthen less."""
    small = table_top(3, n_points=14, n_frames=6, missing=0.0)
    listed = listed_of(small)
    found = adjust(listed, small.cameras, small.shape, focal_known=False, most_steps=300, tolerance=1e-7)
    noise, n = found.noise, 6 * len(small.cameras.scales)
    scale = np.full(n + 1 + small.shape.size, 1.0)
    scale[n] = 1e-3

    def root_costs(step: Numbers) -> Numbers:
        errors = residuals(listed, *moved(found.cameras, found.shape, scale * step)).reshape(2, -1)
        squares = np.sum(errors**2, axis=0)
        costs = (noise.freedom + 2) * np.log1p(squares / (noise.freedom * noise.variance))
        return (errors * np.sqrt(costs / np.maximum(squares, 1e-30))).reshape(-1)

    start = 1e-3 * np.random.default_rng(1).normal(size=len(scale))
    reached = least_squares(root_costs, start, max_nfev=40)
    here = 0.5 * np.sum(root_costs(np.zeros(len(scale))) ** 2)
    assert 0.5 * np.sum(root_costs(start) ** 2) > here + 1
    assert reached.cost == pytest.approx(here, abs=1e-2)


def test_mirrored_cameras_see_the_mirrored_shape_in_the_same_places(small: PerspectiveFilm) -> None:
    places, depths = small.cameras.seen(small.shape)
    mirrored, same = small.cameras.mirrored().seen(small.shape * [1, 1, -1])
    np.testing.assert_allclose(mirrored, places, atol=1e-9)
    np.testing.assert_allclose(same, depths, atol=1e-12)


def test_cameras_without_curvature_are_affine(small: PerspectiveFilm) -> None:
    far = replace(small.cameras, curvature=0.0)
    matrices = far.affine
    wanted = np.einsum("tcj,ij->tic", matrices[..., :3], small.shape) + matrices[:, None, :, 3]
    np.testing.assert_allclose(far.seen(small.shape)[0], wanted, atol=1e-9)


def test_cameras_are_pinholes(small: PerspectiveFilm) -> None:
    cameras = small.cameras
    space = np.einsum("tjk,ik->tij", cameras.rotations, small.shape) + cameras.translations[:, None]
    wanted = cameras.focal * space[..., :2] / space[..., 2:] + cameras.principal
    np.testing.assert_allclose(cameras.seen(small.shape)[0], wanted, atol=1e-9)
    np.testing.assert_allclose(
        np.einsum("tjk,tk->tj", cameras.rotations, cameras.centres) + cameras.translations, 0, atol=1e-12
    )


def test_finds_the_focal_length_from_far(small: PerspectiveFilm) -> None:
    """Without noise the truth is the optimum, and it is found from a start that is half as long."""
    film = turning(2, noise=0.0, n_points=40, n_frames=12)
    start = replace(film.cameras, curvature=2 * film.cameras.curvature)
    found = adjust(listed_of(film), start, film.shape, focal_known=False)
    assert found.cameras.focal == pytest.approx(film.cameras.focal, rel=1e-4)


def test_likelihood_never_falls_and_outliers_hardly_matter() -> None:
    film = turning(4, outliers=0.05, missing=0.4)
    start = film.shape + np.random.default_rng(0).normal(0, 0.02, film.shape.shape)
    likelihoods = [
        adjust(listed_of(film), film.cameras, start, focal_known=False, most_steps=steps).log_likelihood
        for steps in (1, 3, 6, 100)
    ]
    assert np.all(np.diff(likelihoods) > 0)
    found = adjust(listed_of(film), film.cameras, start, focal_known=False)
    assert found.cameras.focal == pytest.approx(film.cameras.focal, rel=0.01)


def test_new_points_are_better_ones() -> None:
    film = table_top(5, outliers=0.05)
    listed = listed_of(film)
    behind = film.shape.copy()
    behind[::4] *= -3
    noise = adjust(listed, film.cameras, film.shape, focal_known=False).noise
    bundle = Bundle(film.cameras, behind, noise, 0.0)
    found = retriangulated(listed, bundle)

    def costs(shape: Numbers) -> Numbers:
        squares = squares_of(listed, film.cameras, shape)
        return np.bincount(listed.own, np.log1p(squares / (noise.freedom * noise.variance)))

    assert np.all(costs(found) <= costs(behind) + 1e-9)
    near = np.linalg.norm(found - film.shape, axis=1) < 0.1
    assert np.mean(near[::4]) > 0.85
