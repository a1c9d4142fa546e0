"""Structure from motion as factor analysis: exact where it can be, at the optimum, with errors as stated."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.experiments.bench.points import bundle_adjustment, turning_points
from rsmcm.apps.scenes import Cylinder, cylinder
from rsmcm.inference.sfm.depth import depth
from rsmcm.inference.sfm.factor_analysis.factorisation import Factorisation, factorise, predicted, projected
from rsmcm.inference.sfm.factor_analysis.observations import ranges
from scipy.optimize import least_squares

from ....support.turning import rotation, through, turning

Numbers = NDArray[np.float64]

FIVE_DIGITS = 5e-6


def explained(positions: Numbers, found: Factorisation) -> float:
    """Greatest difference between positions and what is predicted of them, px."""
    return float(np.nanmax(np.abs(predicted(found)[0] - positions)))


def well_known(found: Factorisation) -> NDArray[np.bool_]:
    """`(n_points,)`: known to half a spread of the shape (one standard deviation) or better."""
    known: NDArray[np.bool_] = np.linalg.eigvalsh(found.shape_covariance)[:, -1] < 0.5**2
    return known


def test_one_coordinate_counts_for_itself() -> None:
    """The least squares optimum over all coordinates that there are, with covariances from these."""
    random = np.random.default_rng(1)
    cameras, shape = random.normal(size=(10, 2, 4)), random.normal(size=(15, 3))
    places = projected(10 * cameras, shape) + 0.2 * random.normal(size=(10, 15, 2))
    weights = random.uniform(0.5, 2, (10, 15)) * (random.random((10, 15)) > 0.1)
    frames, points = np.nonzero(random.random((10, 15)) < 0.3)
    places[frames, points, random.integers(0, 2, len(frames))] = np.nan
    known, roots = ~np.isnan(places) & (weights > 0)[..., None], np.sqrt(weights)[..., None]

    def errors(numbers: Numbers) -> Numbers:
        where = projected(numbers[:80].reshape(10, 2, 4), numbers[80:].reshape(15, 3))
        return np.asarray((roots * (where - places))[known])

    found = factorise(places, weights)
    numbers = np.concatenate([found.cameras.ravel(), found.shape.ravel()])
    dense = least_squares(errors, numbers, xtol=1e-12, ftol=1e-12)
    error = float(np.sum(errors(numbers) ** 2))
    assert error == pytest.approx(2 * dense.cost, rel=1e-4)
    assert found.noise_variance == pytest.approx(error / (known.sum() - 8 * 10 - 3 * 15 + 12), rel=1e-3)
    seen = known[:, 4]
    rows = found.cameras[..., :3][seen] * np.sqrt(weights[:, 4])[seen.nonzero()[0], None]
    expected = np.linalg.inv(rows.T @ rows) * found.noise_variance
    np.testing.assert_allclose(found.shape_covariance[4], expected, rtol=1e-3, atol=1e-6)


# --- exact --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [{"coherence": True}, {"polish": False}, {"start": "svd"}],
)
def test_noise_free_positions_are_recovered(options: dict[str, object]) -> None:
    positions, _, _ = turning()
    assert explained(positions, factorise(positions, **options)) < 1e-6  # type: ignore[arg-type]


@pytest.mark.parametrize("coherence", [False, True])
def test_noise_free_partial_tracks_are_recovered_also_where_not_seen(coherence: bool) -> None:
    positions, _, _ = turning(n_frames=40, n_points=120, degrees=150)
    found = factorise(through(positions, 12), coherence=coherence)
    errors = np.abs(predicted(found)[0] - positions)[found.frame_determined][:, well_known(found)]
    assert errors.size > 0.9 * positions.size
    # EM stops when it gains little: 0.02 px are left of hundreds in one scene of seven
    assert errors.max() < (0.1 if coherence else 1e-6)


@pytest.mark.parametrize("coherence", [False, True])
def test_frames_without_any_point_are_bridged_or_left_open(coherence: bool) -> None:
    positions, _, _ = turning()
    seen, _, _ = turning(noise=0.3)
    seen[7] = np.nan
    found = factorise(seen, coherence=coherence)
    assert np.flatnonzero(~found.frame_determined).tolist() == [7]
    predictions, covariances = predicted(found)
    others = np.arange(20) != 7
    assert np.abs(predictions - positions)[others].max() < 2
    errors = predictions[7] - positions[7]
    squares = np.einsum("ic,ic->i", errors, np.linalg.solve(covariances[7], errors[..., None])[..., 0])
    assert squares.mean() < 2 * 3  # all points share the camera's error, two numbers of variance 1
    if coherence:
        assert np.abs(errors).max() < 3


def test_points_that_are_hardly_seen_do_not_spoil_the_others() -> None:
    positions, _, _ = turning(noise=0.3)
    seen = positions.copy()
    seen[1:, 0] = np.nan
    seen[2:, 1] = np.nan
    seen[:, 2] = np.nan
    for coherence in (False, True):
        found = factorise(seen, coherence=coherence)
        assert not well_known(found)[[0, 2]].any()
        assert well_known(found)[3:].all()
        assert np.abs(predicted(found)[0] - positions)[:, 3:].max() < 2
        assert np.isfinite(found.shape).all()
        # where it was seen the point is known all the same
        assert np.abs(predicted(found)[0] - positions)[0, 0].max() < 2


# --- at the optimum -----------------------------------------------------------------------------------------


def test_least_squares_optimum_equals_that_of_joint_least_squares() -> None:
    positions = turning_points(30, 60, 12)
    found = factorise(positions)
    generator = np.random.default_rng(0)
    cameras = found.cameras + 5 * generator.normal(size=found.cameras.shape)
    shape = found.shape + 0.1 * generator.normal(size=found.shape.shape)
    assert found.rmse == pytest.approx(bundle_adjustment(positions, cameras, shape), rel=1e-6)


def test_weights_count() -> None:
    """An observation of weight 2 is one that was made twice."""
    positions, _, _ = turning(noise=1.0)
    weights = np.random.default_rng(0).integers(0, 3, positions.shape[:2]).astype(np.float64)
    twice = np.where(weights[..., None] == 2, positions, np.nan)
    once = factorise(positions, weights)
    doubled = np.concatenate([np.where(weights[..., None] > 0, positions, np.nan), twice], axis=1)
    # the twins of a point are one point: hold that by taking the shape of the first, in both
    predictions = predicted(once)[0]
    errors = (np.concatenate([predictions, predictions], axis=1) - doubled) ** 2
    assert once.rmse == pytest.approx(np.sqrt(np.nanmean(errors)), rel=1e-9)
    scaled = factorise(positions, 1e6 * weights)
    assert scaled.rmse == pytest.approx(once.rmse, rel=1e-9)
    assert scaled.noise_variance == pytest.approx(1e6 * once.noise_variance, rel=1e-6)


def reached(positions: Numbers, seeds: range) -> Numbers:
    """Errors from random cameras, over the least of them."""
    errors = []
    for seed in seeds:
        cameras = np.random.default_rng(seed).normal(size=(len(positions), 2, 4))
        errors.append(factorise(positions, start=cameras).rmse)
    return np.array(errors) / min(*errors, factorise(positions).rmse)


@pytest.mark.slow
def test_random_starts_reach_the_optimum() -> None:
    """As many frames, points and gaps as the public dinosaur has."""
    positions = turning_points(36, 319, 9)
    assert np.isnan(positions[..., 0]).mean() == pytest.approx(0.77, abs=0.02)
    assert (reached(positions, range(10)) < 1 + FIVE_DIGITS).mean() >= 0.9


def test_an_earlier_result_is_a_start() -> None:
    positions, _, _ = turning(noise=1.0)
    for coherence in (False, True):
        first = factorise(positions, coherence=coherence)
        again = factorise(positions, coherence=coherence, start=first)
        np.testing.assert_allclose(predicted(again)[0], predicted(first)[0], atol=0.3)  # less than the noise


# --- tracks of the cylinder ---------------------------------------------------------------------------------


def camera_error(cameras: Numbers, truth: Cylinder) -> float:
    """Root mean square error of true points seen by cameras, after the best affine change of space."""
    rows = cameras[..., :3].reshape(-1, 3)
    change, *_ = np.linalg.lstsq(rows, truth.cameras[..., :3].reshape(-1, 3))
    shift, *_ = np.linalg.lstsq(rows, (truth.cameras[..., 3] - cameras[..., 3]).reshape(-1))
    seen = (rows @ (truth.shape @ change.T + shift).T).reshape(len(cameras), 2, -1).transpose(0, 2, 1)
    errors = seen + cameras[:, None, :, 3] - truth.positions
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=2))))


def ratios(p_loose: float, p_drift: float, p_regain: float, seeds: range) -> Numbers:
    """Camera errors from partial tracks over those with true identities, both coherent."""
    result = []
    for seed in seeds:
        truth = cylinder(p_loose=p_loose, p_drift=p_drift, p_regain=p_regain, seed=seed)
        oracle = camera_error(factorise(truth.observed, coherence=True).cameras, truth)
        result.append(camera_error(factorise(truth.tracks(), coherence=True).cameras, truth) / oracle)
    return np.array(result)


@pytest.mark.parametrize(("p_loose", "p_drift", "most"), [(0.05, 0.1, 5.0), (0.12, 0.3, 8.0)])
def test_partial_tracks_give_cameras_near_those_of_whole_ones(
    p_loose: float, p_drift: float, most: float
) -> None:
    """A rest stays: nothing tells tracks of different times that they show one point."""
    assert ratios(p_loose, p_drift, 0.5, range(3)).max() < most


def test_coherence_bridges_frames_that_share_no_points() -> None:
    positions, _, _ = turning(n_frames=30, n_points=40, noise=0.2, degrees=90)
    apart = np.full((30, 80, 2), np.nan)
    apart[:15, :40], apart[15:, 40:] = positions[:15], positions[15:]
    with pytest.raises(ValueError, match="frames 15-29 that share fewer than 4 points"):
        factorise(apart)
    found = factorise(apart, coherence=True)
    assert explained(apart, found) < 2
    predictions, _ = predicted(found)
    assert np.abs(predictions[:15, 40:] - positions[:15]).mean() < 15  # the cloud is 100 px large


# --- consistent ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("coherence", [False, True])
def test_covariances_are_as_large_as_errors(coherence: bool) -> None:
    """Squared errors over their stated variances, seen and not seen; 1 is exact.

    Of 24 frames x 30 points some 1,000 numbers count each time, with errors that belong together; q(M) q(S)
    leaves out what cameras and points have in common, which shows far from where a point was seen.
    """
    seen_ratio, unseen_ratio, noises = [], [], []
    for seed in range(4):
        truth, _, _ = turning(n_frames=24, n_points=30, degrees=60)
        noise = np.random.default_rng(seed).normal(size=truth.shape)
        observed = through(truth + noise, 16, seed)
        found = factorise(observed, coherence=coherence)
        predictions, covariances = predicted(found)
        errors = predictions - truth
        squares = 0.5 * np.einsum(
            "tic,tic->ti", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]
        )
        seen = ~np.isnan(observed[..., 0])
        seen_ratio.append(squares[seen].mean())
        unseen_ratio.append(squares[~seen].mean())
        noises.append(found.noise_variance)
    assert 0.7 < np.mean(seen_ratio) < 1.3
    assert 0.6 < np.mean(unseen_ratio) < 2.0
    assert np.mean(noises) == pytest.approx(1.0, abs=0.1)


def test_predictions_of_points_have_both_uncertainties() -> None:
    positions, _, _ = turning(n_frames=5, n_points=6, noise=1.0)
    found = factorise(positions)
    _, covariances = predicted(found)
    generator = np.random.default_rng(0)
    t, i, n = 2, 3, 200_000
    rows = found.cameras[t] + np.einsum(
        "jk,nck->ncj", np.linalg.cholesky(found.camera_covariance[t]), generator.normal(size=(n, 2, 4))
    )
    places = generator.multivariate_normal(found.shape[i], found.shape_covariance[i], n)
    samples = np.einsum("ncj,nj->nc", rows[..., :3], places) + rows[..., 3]
    # standard error of a variance from n samples: sqrt(2 / n) of it
    np.testing.assert_allclose(
        np.cov(samples.T), covariances[t, i], rtol=0.02, atol=0.02 * covariances[t, i, 0, 0]
    )


# --- what must not matter -----------------------------------------------------------------------------------


@settings(max_examples=5)
@given(
    seed=st.integers(0, 100),
    angle=st.floats(0, 2 * np.pi),
    scale=st.sampled_from([1e-6, 0.01, 1.0, 1e5]),
    coherence=st.booleans(),
)
def test_numbering_of_points_units_and_turns_of_the_picture_do_not_matter(
    seed: int, angle: float, scale: float, coherence: bool
) -> None:
    positions, _, _ = turning(n_frames=12, n_points=20, noise=1.0)
    positions = through(positions, 9)
    order = np.random.default_rng(seed).permutation(20)
    turn, shift = scale * rotation(2, angle)[:2, :2], scale * np.array([1000.0, -400.0])
    plain = factorise(positions, coherence=coherence)
    other = factorise((positions @ turn.T + shift)[:, order], coherence=coherence)
    # coherent EM stops near the optimum, not at it; u and v turned differ in rounding from the first step on
    tolerance = 1e-2 if coherence else 1e-5
    predictions, covariances = predicted(plain)
    turned, spreads = predicted(other)
    np.testing.assert_allclose(
        turned / scale, ((predictions @ turn.T + shift) / scale)[:, order], atol=50 * tolerance
    )
    expected = (turn @ covariances @ turn.T)[:, order] / scale**2
    np.testing.assert_allclose(spreads / scale**2, expected, rtol=0.3 if coherence else 1e-3, atol=tolerance)
    assert other.noise_variance / scale**2 == pytest.approx(plain.noise_variance, rel=10 * tolerance)


# --- depth --------------------------------------------------------------------------------------------------


def flat(kind: str, n_frames: int, n_points: int, generator: np.random.Generator) -> Numbers:
    """Positions that show no depth, with noise."""
    points = 100 * generator.normal(size=(n_points, 2))
    moved = np.zeros((n_frames, n_points, 2))
    for t in range(n_frames):
        angle = 0.05 * t if kind == "turned in the picture" else 0.0
        moved[t] = points @ rotation(2, angle)[:2, :2].T + (3.0 * t if kind == "panned" else 0.0)
    positions: Numbers = moved + generator.normal(size=moved.shape)
    return positions


@pytest.mark.parametrize("coherence", [False, True])
@pytest.mark.parametrize("kind", ["turned in the picture", "static with gaps"])
def test_where_the_camera_shows_no_depth_there_is_none(kind: str, coherence: bool) -> None:
    generator = np.random.default_rng(5)
    for n_frames, n_points in ((10, 10), (30, 15)):
        positions = flat(kind, n_frames, n_points, generator)
        if kind.endswith("gaps"):
            positions[generator.random(positions.shape[:2]) < 0.3] = np.nan
        assert not depth(positions, None, factorise(positions, coherence=coherence)).determined


def test_a_camera_that_turns_shows_depth() -> None:
    positions, _, _ = turning(noise=1.0)
    assert depth(positions, None, factorise(positions)).determined
    tracks = cylinder(p_loose=0.12, p_drift=0.3).tracks()
    assert depth(tracks, None, factorise(tracks, coherence=True)).determined


def test_without_noise_a_static_camera_shows_no_depth_either() -> None:
    positions = np.repeat(np.random.default_rng(0).normal(size=(1, 12, 2)), 10, axis=0)
    for coherence in (False, True):
        found = factorise(positions, coherence=coherence)
        assert np.isfinite(found.shape).all()
        assert not depth(positions, None, found).determined


# --- bad input ----------------------------------------------------------------------------------------------


def test_bad_input_is_named() -> None:
    positions, _, _ = turning()
    infinite = positions.copy()
    infinite[3, 4] = np.inf
    weights = np.ones(positions.shape[:2])
    negative = weights.copy()
    negative[1, 2] = -1
    found = factorise(positions)
    for arguments, options, message in (
        ((positions[..., 0],), {}, r"positions: got \(20, 15\), expected \(n_frames, n_points, 2\)"),
        ((positions[:2],), {}, "got 2 frames and 15 points, expected 3 frames and 4 points"),
        ((positions[:, :3],), {}, "got 20 frames and 3 points, expected 3 frames and 4 points"),
        ((infinite,), {}, r"positions: got \[inf, inf\] at frame 3, point 4, expected finite"),
        ((positions, weights[:3]), {}, r"weights: got \(3, 15\), expected \(20, 15\)"),
        ((positions, negative), {}, "weights: got -1.0 at frame 1, point 2, expected 0 or more"),
        ((positions, 0 * weights), {}, "got no observation at all"),
        ((0 * positions,), {}, "got all points of a frame in one place"),
        ((positions,), {"start": "guess"}, "start: got 'guess'"),
        ((positions,), {"start": np.zeros((3, 2, 4))}, r"start: got \(3, 2, 4\)"),
        ((positions,), {"start": replace(found, shape=found.shape[1:])}, "20 frames and 14 points"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            factorise(*arguments, **options)  # type: ignore[arg-type]
        assert "\n" not in str(caught.value)


def test_frames_that_share_no_points_are_named() -> None:
    positions, _, _ = turning(n_frames=12, n_points=20)
    apart = np.full((12, 20, 2), np.nan)
    apart[:4, :10], apart[4:8, 10:], apart[8:, :10] = (
        positions[:4, :10],
        positions[4:8, 10:],
        positions[8:, :10],
    )
    with pytest.raises(ValueError, match="frames 4-7 that share fewer than 4 points"):
        factorise(apart)
    few = np.full((12, 20, 2), np.nan)
    few[:2] = positions[:2]
    with pytest.raises(ValueError, match="got 2 frames with 4 points that other frames show too"):
        factorise(few)


def test_ranges_of_numbers() -> None:
    assert ranges([0, 1, 2, 5, 7, 8]) == "0-2, 5, 7-8"
