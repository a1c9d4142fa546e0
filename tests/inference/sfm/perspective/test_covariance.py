"""Uncertainties of focal length and positions against the dense information, Monte Carlo, and the gauge."""

from dataclasses import replace

import numpy as np
import pytest
from rsmcm.inference.sfm.perspective.bundle_adjustment import (
    Bundle,
    StudentNoise,
    adjust,
    covariance_of,
    gauge_of,
    predicted,
    systematic_fields,
)
from rsmcm.models.numerics.rotations import exponential

from ....support.perspective_films import PerspectiveFilm, table_top
from .test_bundle_adjustment import dense_jacobian, listed_of

VAGUE = 1e8 * np.eye(3)


def test_positions_do_not_change_along_the_gauge() -> None:
    """A turned, grown and moved shape before cameras that follow is seen where it was."""
    film = table_top(1, n_points=10, n_frames=5)
    gauge = gauge_of(film.cameras)
    assert np.linalg.matrix_rank(gauge) == 7
    small = 1e-5
    for k, column in enumerate(gauge.T):
        by_camera = small * column[:-1].reshape(-1, 6)
        cameras = replace(
            film.cameras,
            rotations=exponential(by_camera[:, :3]) @ film.cameras.rotations,
            scales=film.cameras.scales * np.exp(by_camera[:, 3]),
            shifts=film.cameras.shifts + by_camera[:, 4:],
        )
        if k < 3:
            shape = film.shape @ exponential(small * np.eye(3)[k : k + 1])[0].T
        elif k == 3:
            shape = film.shape * np.exp(small)
        else:
            shape = film.shape + small * np.eye(3)[k - 4]
        moved, before = cameras.seen(shape)[0], film.cameras.seen(film.shape)[0]
        assert np.abs(moved - before).max() < 1e-5
        assert np.abs(cameras.seen(film.shape)[0] - before).max() > 1e-4


@pytest.mark.parametrize("focal_known", [False, True])
def test_covariances_are_those_of_the_dense_information(focal_known: bool) -> None:
    """Of positions, in which the gauge is no matter: J (J^T J)^+ J^T."""
    film = table_top(3, n_points=16, n_frames=6, missing=0.1)
    listed = listed_of(film)
    found = adjust(listed, film.cameras, film.shape, focal_known=focal_known)
    found = replace(found, noise=StudentNoise(1.0, 1e9))  # all observations count alike
    covariance = covariance_of(listed, found, VAGUE, focal_known=focal_known)
    jacobian = dense_jacobian(listed, found.cameras, found.shape)
    if focal_known:
        jacobian = np.delete(jacobian, 6 * len(film.cameras.scales), axis=1)
    size = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.pinv(jacobian / size, rcond=1e-7)
    wanted = (jacobian / size) @ inverse @ inverse.T @ (jacobian / size).T
    _, covariances = predicted(found, covariance)
    n = len(listed.x)
    of_places = covariances[listed.other, listed.own]
    ratio = of_places[:, 0, 0] / np.diag(wanted)[:n]
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=1e-3)
    np.testing.assert_allclose(of_places[:, 0, 1], ratio.mean() * np.diag(wanted[:n, n:]), atol=1e-3)


def test_errors_in_common_change_the_focal_length_as_is_stated() -> None:
    """As linear least squares with the dense derivatives says of each of them."""
    film = table_top(2, n_points=40, n_frames=8)
    listed = listed_of(replace(film, tracks=film.cameras.seen(film.shape)[0]))
    noise = StudentNoise(1.0, 1e9)  # all observations count alike
    found = replace(adjust(listed, film.cameras, film.shape, focal_known=False), noise=noise)
    stated = covariance_of(listed, found, VAGUE, focal_known=False).systematic_curvature
    jacobian = dense_jacobian(listed, found.cameras, found.shape)
    size = np.linalg.norm(jacobian, axis=0)
    fields = systematic_fields(listed, noise)
    changes = np.linalg.pinv(jacobian / size, rcond=1e-7) @ fields.reshape(len(fields), -1).T / size[:, None]
    assert stated == pytest.approx(np.linalg.norm(changes[6 * len(film.cameras.scales)]), rel=0.01)
    assert covariance_of(listed, found, VAGUE, focal_known=True).systematic_curvature == 0


@pytest.mark.slow
def test_focal_lengths_scatter_as_is_stated() -> None:
    """Over films that differ in their noise only, the deviation is honest to its sampling error."""
    base = table_top(2, n_points=60, n_frames=12, missing=0.3)
    truth, _ = base.cameras.seen(base.shape)
    errors, deviations, distances = [], [], []
    for seed in range(24):
        noise = np.random.default_rng(100 + seed).normal(0, 0.3, truth.shape)
        tracks = np.where(np.isnan(base.tracks), np.nan, truth + noise)
        film = PerspectiveFilm(base.cameras, base.shape, tracks, base.size)
        listed = listed_of(film)
        found: Bundle = adjust(listed, base.cameras, base.shape, focal_known=False)
        covariance = covariance_of(listed, found, VAGUE, focal_known=False)
        errors.append(found.cameras.curvature - base.cameras.curvature)
        deviations.append(covariance.curvature_deviation)
        positions, covariances = predicted(found, covariance)
        error = (positions - truth)[..., None]
        distances.append(np.sum(error * np.linalg.solve(covariances, error), axis=(2, 3)))
    ratio = np.std(errors) / np.mean(deviations)
    assert 0.6 < ratio < 1.5  # 24 draws: 15 % to one deviation
    assert abs(np.mean(errors)) < 4 * np.mean(deviations) / np.sqrt(24)
    assert np.median(distances) == pytest.approx(2 * np.log(2), rel=0.25)  # of a squared length in the plane
