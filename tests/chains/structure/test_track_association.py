"""Association of partial tracks: formulas against dense ones, and cylinders whose truth is known."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.evaluation.structure import score_structure
from rsmcm.apps.scenes import cylinder
from rsmcm.chains.structure.kernels import camera_coupling
from rsmcm.chains.structure.track_association import (
    CorrelatedNoise,
    associate_tracks,
    estimate_correlated_noise,
    log_odds_of_new,
    log_partition,
    motion_precision,
    unite_points,
)
from rsmcm.inference.sfm.factor_analysis.factorisation import factorise, factorise_robustly, predicted
from rsmcm.inference.sfm.factor_analysis.observations import Observations
from scipy.stats import multivariate_normal

Numbers = NDArray[np.float64]

NOISE = CorrelatedNoise(white=0.5, drift=1.3, memory=2.8)


def small_problem(seed: int) -> tuple[Observations, Numbers, Numbers, NDArray[np.int64]]:
    """Three tracks of two points with gaps, random cameras, and the points' homogeneous coordinates."""
    random = np.random.default_rng(seed)
    positions, weights = random.normal(size=(8, 4, 2)), np.zeros((8, 4))
    for track, frames in enumerate(([0, 1, 3, 4], [2, 3, 4], [1, 2, 5, 6, 7], [0])):
        weights[frames, track] = random.uniform(0.5, 2, len(frames))
    observations = Observations.from_arrays(positions, weights)
    points = np.concatenate([random.normal(size=(3, 3)), np.ones((3, 1))], axis=1)
    return observations, random.normal(size=(8, 2, 4)), points, np.array([0, 1, 0, 2])


def noise_covariance(observations: Observations, track: int) -> tuple[NDArray[np.int64], Numbers]:
    """Frames of a track and the covariance of its errors along an axis."""
    tracks = observations.by_point
    part = slice(tracks.edges[track], tracks.edges[track + 1])
    frames = tracks.other[part]
    drift = NOISE.drift * NOISE.decay ** np.abs(frames[:, None] - frames)
    return frames, np.diag(NOISE.white / tracks.weight[part]) + drift


def test_what_tracks_say_equals_dense_regression() -> None:
    observations, cameras, _, _ = small_problem(1)
    tracks = observations.by_point
    information, vector, quadratic, determinant = NOISE.information(tracks, cameras)
    for track in range(4):
        frames, covariance = noise_covariance(observations, track)
        part = slice(tracks.edges[track], tracks.edges[track + 1])
        precision, rows = np.linalg.inv(covariance), cameras[frames][..., :3]
        seen = np.stack([tracks.x[part], tracks.y[part]], axis=1) - cameras[frames][..., 3]
        np.testing.assert_allclose(
            information[track], np.einsum("ab,ari,brj->ij", precision, rows, rows), rtol=1e-12, atol=1e-12
        )
        np.testing.assert_allclose(
            vector[track], np.einsum("ab,ari,br->i", precision, rows, seen), rtol=1e-12, atol=1e-12
        )
        assert quadratic[track] == pytest.approx(np.einsum("ab,ar,br", precision, seen, seen))
        assert determinant[track] == pytest.approx(2 * np.linalg.slogdet(covariance)[1])


def test_coupling_of_cameras_equals_dense_derivatives() -> None:
    observations, cameras, points, point = small_problem(2)
    tracks = observations.by_point
    own, cross = camera_coupling(
        tracks, point, points, cameras,
        NOISE.white, NOISE.drift, NOISE.decay, 1e-14,
    )  # fmt: skip
    expected_own, expected_cross = np.zeros((8, 4, 8, 4)), np.zeros((2, 8, 4, 3, 3))
    for track in range(4):
        frames, covariance = noise_covariance(observations, track)
        precision, s = np.linalg.inv(covariance), points[point[track]]
        for a, first in enumerate(frames):
            for b, second in enumerate(frames):
                expected_own[first, :, second] += precision[a, b] * np.outer(s, s)
                for row in range(2):
                    expected_cross[row, first, :, point[track]] += precision[a, b] * np.outer(
                        s, cameras[second, row, :3]
                    )
    np.testing.assert_allclose(own, expected_own, atol=1e-10)
    np.testing.assert_allclose(cross, expected_cross, atol=1e-10)


def test_motion_precision_equals_dense_state_space() -> None:
    """Third differences of eq. (19), into which the first state does not enter."""
    n_frames, variances = 9, np.array([0.3, 0.2, 0.5])
    step = np.array([[1, 1, 0.5], [0, 1, 1], [0, 0, 1]])
    chain = np.zeros((3 * n_frames, 3 * n_frames))  # all states as a linear function of all noise
    for time in range(n_frames):
        for source in range(time + 1):
            chain[3 * time : 3 * time + 3, 3 * source : 3 * source + 3] = np.linalg.matrix_power(
                step, time - source
            )
    noise = np.concatenate([np.zeros(3), np.tile(variances, n_frames - 1)])
    covariance = (chain * noise @ chain.T)[::3, ::3]
    thirds = np.diff(np.eye(n_frames), 3, axis=0)
    precision = motion_precision(variances, n_frames)
    expected = thirds.T @ np.linalg.inv(thirds @ covariance @ thirds.T) @ thirds
    np.testing.assert_allclose(precision, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    assert not motion_precision(variances, 3).any()


def test_log_partition_is_the_integral() -> None:
    random = np.random.default_rng(0)
    root = random.normal(size=(3, 3))
    covariance, mean = root @ root.T + np.eye(3), random.normal(size=3)
    information = np.linalg.inv(covariance)
    density = multivariate_normal(mean, covariance).logpdf(np.zeros(3))
    # exp(log partition + 3/2 log 2 pi) normalises exp(vector . x - x . information x / 2), which is 1 at 0
    value = log_partition(information, information @ mean) + 1.5 * np.log(2 * np.pi)
    assert -value == pytest.approx(density)


def test_sure_pairs_are_united_and_others_follow() -> None:
    """What parts 0 from 1 is the error that also parts 2 from 3."""
    mean = np.zeros((6, 3))
    mean[2:4], mean[4], mean[5] = 5.0, -5.0, (5, -5, 0)
    mean[1] += (1.0, 0, 0)
    mean[3] += (1.0, 0, 0)
    covariance = 1e-4 * np.eye(18).reshape(6, 3, 6, 3)
    shared = np.zeros((6, 3))
    shared[[1, 3], 0] = 1.0  # both were seen by the same uncertain cameras
    covariance += np.einsum("ia,jb->iajb", shared, shared)
    apart = np.zeros((6, 6), bool)
    group = unite_points(mean, covariance, apart, 8 * np.eye(3), log_new=1.0, margin=3.0)
    np.testing.assert_array_equal(group, [0, 0, 2, 2, 4, 5])
    apart[0, 1] = apart[1, 0] = True
    group = unite_points(mean, covariance, apart, 8 * np.eye(3), log_new=1.0, margin=3.0)
    np.testing.assert_array_equal(group, [0, 1, 2, 2, 4, 5])


def test_ambiguous_pairs_wait() -> None:
    """Point 0 fits 1 and 2 alike, and these two were seen at once."""
    mean = np.array([[0.0, 0, 0], [0.1, 0, 0], [-0.1, 0, 0]])
    covariance = 1e-2 * np.eye(9).reshape(3, 3, 3, 3)
    apart = np.zeros((3, 3), bool)
    apart[1, 2] = apart[2, 1] = True
    united = unite_points(mean, covariance, apart, 8 * np.eye(3), log_new=1.0, margin=1.0)
    np.testing.assert_array_equal(united, [0, 1, 2])
    forced = unite_points(mean, covariance, apart, 8 * np.eye(3), log_new=1.0, margin=-1.0)
    assert len(np.unique(forced)) == 2


@pytest.mark.parametrize(("white", "drift", "memory"), [(0.01**2, 0.0, None), (0.01**2, 0.05**2, 3.0)])
def test_noise_is_found_from_tracks(white: float, drift: float, memory: float | None) -> None:
    """40 points in 60 frames leave about 4600 residuals, 800 or so where drift lasts for three frames."""
    scene = cylinder(p_loose=0.0, p_drift=0.0, noise=0.0, seed=3)
    random = np.random.default_rng(4)
    tracks = scene.positions + random.normal(scale=np.sqrt(white), size=scene.positions.shape)
    state = random.normal(size=(40, 2))
    for frame in tracks:
        frame += np.sqrt(drift) * state
        decay = np.exp(-1 / (memory or 1.0))
        state = decay * state + np.sqrt(1 - decay**2) * random.normal(size=state.shape)
    observations = Observations.from_arrays(tracks)
    cameras = scene.cameras / observations.scale
    cameras[..., 3] -= observations.centre / observations.scale
    found = estimate_correlated_noise(observations.by_point, cameras, np.arange(40), np.eye(3))
    total = (found.white + found.drift) * observations.scale**2
    assert total == pytest.approx(white + drift, rel=0.25 if drift else 0.1)
    assert found.drift / (found.white + found.drift) == pytest.approx(drift / (white + drift), abs=0.1)
    if memory is not None:
        assert 1.5 <= found.memory <= 6


@pytest.mark.parametrize("coherence", [False, True])
def test_partial_tracks_are_joined(coherence: bool) -> None:
    """Without drift the truth is recovered: what is left is the error of factor analysis that knows it."""
    scene = cylinder(p_loose=0.1, p_drift=0.0, seed=0)
    found = associate_tracks(scene.tracks(), coherence=coherence)
    positions, _ = predicted(found.factorisation)
    measures = score_structure(positions, found.factorisation.shape, found.point_of_track, scene)
    knowing, _ = predicted(factorise(scene.observed, coherence=coherence))
    error = np.sqrt(np.square(knowing - scene.positions).sum(axis=2).mean())
    assert measures.reprojection_error <= 1.2 * error
    assert measures.n_points == 40
    assert measures.purity >= 0.97


@pytest.mark.parametrize("share", [0.002, 0.03])
def test_share_of_pairs_in_one_place_is_learned(share: float) -> None:
    random = np.random.default_rng(0)
    one = random.random(200_000) < share
    error, spread = 0.01, 1.0

    def gains(off: Numbers) -> Numbers:
        wide, near = spread**2 + error**2, error**2
        square: Numbers = (off**2).sum(axis=1)
        return 1.5 * np.log(wide / near) + square / 2 * (1 / wide - 1 / near)

    off = np.where(one, error, np.hypot(error, spread))[:, None] * random.normal(size=(len(one), 3))
    different = np.hypot(error, spread) * random.normal(size=(50_000, 3))
    together = np.concatenate([gains(off), gains(different)])
    apart = np.arange(len(together)) >= len(one)
    assert log_odds_of_new(together, apart) == pytest.approx(np.log((1 - share) / share), abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_sparse_short_tracks_are_not_refused(seed: int) -> None:
    """Association is not worse than none, where most tracks are the only ones of their points."""
    scene = cylinder(
        n_points=400, n_frames=24, p_loose=0.35, p_drift=0.0, p_regain=0.02, degrees_per_frame=10.0, seed=seed
    )
    tracks = scene.tracks()
    lengths = (~np.isnan(tracks[..., 0])).sum(axis=0)
    tracks = tracks[:, (lengths > 1)]
    truth = scene.positions[:, scene.point_of_track[lengths > 1]]
    found = associate_tracks(tracks, coherence=True)
    assert (found.point_of_track >= 0).mean() >= 0.95
    none = factorise_robustly(tracks, coherence=True)
    seen = ~np.isnan(tracks[..., 0]) & (found.point_of_track >= 0)
    off = predicted(found.factorisation)[0][:, found.point_of_track] - truth
    alone = predicted(none.factorisation)[0] - truth
    error, without = (np.sqrt(np.square(each[seen]).sum(axis=1).mean()) for each in (off, alone))
    assert error <= without


def test_tracks_seen_together_are_never_one() -> None:
    scene = cylinder(p_loose=0.05, p_drift=0.1, seed=6)
    tracks = scene.tracks()
    point = associate_tracks(tracks, coherence=True).point_of_track
    seen = ~np.isnan(tracks[..., 0])
    for number in range(point.max() + 1):
        assert seen[:, point == number].sum(axis=1).max() <= 1
