"""Deformable shapes from tracks: against shapes that are known, and sums written out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.inference.sfm.nonrigid import em
from rsmcm.inference.sfm.nonrigid import learning as start
from rsmcm.inference.sfm.nonrigid.learning import (
    LEAST_LEFT,
    choose_bases,
    learn_shape,
    rotations_of_rank,
    withheld,
)
from rsmcm.inference.sfm.nonrigid.shape import NonrigidShape, shape_error, triangles_in_front
from rsmcm.models.numerics.rotations import exponential, logarithm, nearest_rotation
from scipy.stats import multivariate_normal

from ....support.deforming import MIRROR, N_BASES, N_FRAMES, N_POINTS, NOISE, deforming, error, holes
from ....support.stick_figures import stick_figure

Numbers = NDArray[np.float64]


@given(st.integers(0, 1000), st.sampled_from([0.0, 0.3]))
@settings(max_examples=2, deadline=None)
def test_likelihood_never_falls(seed: int, missing: float) -> None:
    positions, _ = deforming(n_frames=12, seed=seed)
    found = learn_shape(holes(positions, missing, seed), N_BASES, iterations=30, tolerance=0)
    gains = np.diff(found.history)
    assert (gains > -1e-9 * np.abs(found.history[:-1])).all()


# --- whole shapes -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def learned() -> NonrigidShape:
    return learn_shape(deforming()[0], N_BASES)


def test_shapes_are_recovered_also_where_points_were_not_seen() -> None:
    missing = 0.3
    positions, truth = deforming()
    found = learn_shape(holes(positions, missing), N_BASES, iterations=100)
    # noise is 1 % of the size; depth of what deforms and turns at once is known less well
    assert error(found.shapes(), truth) < 0.04
    # the most likely noise is too small by the numbers fitted: 6 of each pose, 3 of each point of each basis
    count = 2 * N_FRAMES * N_POINTS * (1 - missing)
    expected = NOISE * np.sqrt(1 - (6 * N_FRAMES + 3 * N_POINTS * N_BASES) / count)
    assert found.noise == pytest.approx(expected, rel=0.3)  # what deforms takes part of it
    assert found.rmse < found.noise


def test_conventions_of_the_model(learned: NonrigidShape) -> None:
    positions, _ = deforming()
    mean = learned.bases[0]
    assert np.sqrt(np.mean(np.sum(mean[:, :2] ** 2, axis=1))) == pytest.approx(1)
    np.testing.assert_allclose(learned.bases.mean(axis=1), 0, atol=1e-12)
    mean_rotation = learned.rotations.mean(axis=0)
    np.testing.assert_allclose(mean_rotation, mean_rotation.T, atol=1e-9)  # its nearest rotation is 1
    np.testing.assert_allclose(np.linalg.det(learned.rotations), 1)
    np.testing.assert_allclose(learned.weights.mean(axis=0), 0, atol=0.05)
    # means of posteriors vary less than the weights
    np.testing.assert_allclose(learned.weights.std(axis=0), 1, atol=0.12)
    # true shape: margin behind the middle, as the true one
    margin = np.sum(mean[:, :2] ** 2, axis=1)
    assert np.corrcoef(mean[:, 2], margin)[0, 1] > 0.2
    sizes = np.linalg.norm(learned.bases[1:, :, :2], axis=(1, 2))
    assert (np.diff(sizes) <= 0).all()
    model = learned.model()
    corners = model.bases[0][model.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0).all()
    np.testing.assert_allclose(learned.shapes()[..., :2], model.project(learned.poses))
    squares = (learned.shapes()[..., :2] - positions) ** 2
    assert np.sqrt(squares.mean()) == pytest.approx(learned.rmse, rel=1e-9)
    size = np.sqrt(np.mean(learned.scales) ** 2)
    assert learned.relative_error == pytest.approx(np.sqrt(2) * learned.rmse / size)


def test_log_likelihood_is_that_of_tracks_in_px(learned: NonrigidShape) -> None:
    positions, _ = deforming()
    total = 0.0
    for seen, rotation, scale, shift in zip(
        positions, learned.rotations, learned.scales, learned.translations, strict=True
    ):
        matrix = scale * np.stack([(basis @ rotation[:2].T).ravel() for basis in learned.bases], axis=1)
        covariance = matrix[:, 1:] @ matrix[:, 1:].T + learned.noise**2 * np.eye(2 * N_POINTS)
        mean = matrix[:, 0] + np.tile(shift, N_POINTS)
        total += multivariate_normal(mean, covariance).logpdf(seen.ravel())
    assert learned.log_likelihood == pytest.approx(total, rel=1e-8)


@pytest.mark.slow
def test_order_of_points_place_and_unit_do_not_matter(learned: NonrigidShape) -> None:
    positions, _ = deforming()
    order = np.random.default_rng(0).permutation(N_POINTS)
    found = learn_shape(3 * positions[:, order] + [700, -90], N_BASES)
    # EM stops a little short of the optimum, and rounding takes it there by other ways
    assert error(found.shapes(), 3 * learned.shapes()[:, order]) < 5e-4
    assert found.noise == pytest.approx(3 * learned.noise, rel=5e-4)


def test_frames_that_show_hardly_anything_are_left_open() -> None:
    positions, truth = deforming()
    positions[7] = np.nan
    positions[20, 3:] = np.nan
    found = learn_shape(positions, N_BASES, iterations=60)
    assert np.flatnonzero(~found.frame_determined).tolist() == [7, 20]
    shapes = found.shapes()
    assert np.isnan(shapes[[7, 20]]).all()
    assert error(shapes[found.frame_determined], truth[found.frame_determined]) < 0.02


# --- what cannot be ----------------------------------------------------------------------------------------


def with_value(value: float, place: tuple[int, ...] = (4, 2)) -> Numbers:
    positions, _ = deforming(n_frames=10)
    positions[place] = value
    return positions


def on_lines() -> Numbers:
    """In every frame on another line, one point hidden."""
    angles, along = np.linspace(0, 1, 10), np.random.default_rng(0).uniform(-90, 90, (10, 20))
    lines = along[..., None] * np.column_stack([np.cos(angles), np.sin(angles)])[:, None] + [160, 120]
    lines[3, 5] = np.nan
    return np.asarray(lines)


@pytest.mark.parametrize(
    ("tracks", "bases", "message"),
    [
        (np.zeros((5, 8)), 2, r"tracks: got \(5, 8\), expected \(n_frames, n_points, 2\)"),
        (np.zeros((5, 8, 3)), 2, r"tracks: got \(5, 8, 3\)"),
        (np.full((9, 8, 2), np.nan), 2, "got 0 frames that show 4 points or more, expected 3"),
        (deforming(n_frames=2)[0], 2, "got 2 frames that show 4 points or more, expected 3"),
        (with_value(np.nan, (slice(None), 5)), 2, "got point 5 in 0 frames, expected 3 at least"),  # type: ignore[arg-type]
        (with_value(np.inf), 2, "at point 2 of frame 4 .both from 0., expected finite px"),
        (with_value(1e9), 2, "at point 2 of frame 4 .both from 0., expected finite px"),
        (
            with_value(np.nan, (4, 2, 0)),
            2,
            "at point 2 of frame 4 .both from 0., expected both coordinates or none",
        ),
        (deforming(n_frames=10)[0], 1, "bases: got 1, expected 2 to 6 for 10 frames, 20 points"),
        (deforming(n_frames=10)[0], 7, "bases: got 7, expected 2 to 6"),
        (deforming(n_frames=10)[0][:, :6], 2, "got 6 points, expected 7 at least"),
        (np.ones((9, 8, 2)), 2, "points that all lie in one place"),
        (on_lines(), 2, "got points on a line in every frame"),
    ],
)
def test_tracks_that_cannot_be_learned_from(tracks: Numbers, bases: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        learn_shape(tracks, bases)


def test_points_on_a_line_have_no_triangles() -> None:
    line = np.column_stack([np.arange(8.0), 2 * np.arange(8.0), np.zeros(8)])
    with pytest.raises(ValueError, match="points on a line"):
        triangles_in_front(line)


def test_error_is_mean_distance_over_mean_deviation_up_to_one_mirror_image() -> None:
    random = np.random.default_rng(0)
    truth = random.standard_normal((6, 9, 3)) * [3, 2, 1]
    found = truth + 0.1 * random.standard_normal(truth.shape)
    found[4] = np.nan
    distances, deviations = [], []
    for frame in (0, 1, 2, 3, 5):
        one, other = found[frame] - found[frame].mean(axis=0), truth[frame] - truth[frame].mean(axis=0)
        distances += [np.sqrt(np.sum((one[j] - other[j]) ** 2)) for j in range(9)]
        deviations += [np.sqrt(np.mean(other[:, axis] ** 2)) for axis in range(3)]
    expected = np.mean(distances) / np.mean(deviations)
    assert shape_error(found, truth) == pytest.approx(expected)
    assert shape_error(found * [1, 1, -1] + [5, 6, 7], truth) == pytest.approx(expected)
    found[:2, :, 2] *= -1  # not every frame its own
    assert shape_error(found, truth) > 2 * expected


def test_arrays_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match=r"got \(2, 5, 3\) and \(2, 4, 3\), expected"):
        shape_error(np.zeros((2, 5, 3)), np.zeros((2, 4, 3)))
    with pytest.raises(ValueError, match="no frame that is known in both"):
        shape_error(np.full((2, 5, 3), np.nan), np.zeros((2, 5, 3)))


@pytest.mark.slow
def test_as_many_as_there_are() -> None:
    positions, _ = deforming()
    found = choose_bases(positions, range(2, 5))
    assert found.bases == N_BASES
    assert found.candidates == (2, 3, 4)
    assert found.errors[0] > 1.5 * found.errors[1]


def test_frames_and_points_keep_what_they_need() -> None:
    positions = holes(deforming(n_frames=40)[0], 0.3)
    positions[5, 5:] = np.nan
    positions[6:, 3] = np.nan
    seen = ~np.isnan(positions[..., 0])
    hidden = withheld(positions)
    assert not (hidden & ~seen).any()
    assert not hidden[5].any()
    left = seen & ~hidden
    for axis in (0, 1):
        assert (left.sum(axis=axis) >= np.minimum(LEAST_LEFT, seen.sum(axis=axis))).all()
    assert hidden.sum() == pytest.approx(0.1 * seen.sum(), rel=0.4)


BASES = 5


def test_modes_that_only_fit_noise_are_taken_away() -> None:
    found = learn_shape(deforming(seed=3)[0], N_BASES, iterations=40)
    assert len(found.details) == 0
    assert found.detail_weights.shape == (60, 0)


@pytest.mark.slow
def test_a_person_before_a_camera_that_goes_round() -> None:
    truth = stick_figure(200, seed=1)
    found = learn_shape(truth[..., :2], BASES, iterations=60)
    assert shape_error(found.shapes(), truth) < 0.2
    assert len(found.bases) == BASES
    assert len(found.details) > 0  # a person bends in more ways than four
    gaps = [each.log_likelihood_gap for each in found.rivals]
    assert gaps == sorted(gaps)
    assert all(each.disagreement > 0.01 for each in found.rivals)


@pytest.mark.slow
def test_errors_are_as_large_as_stated() -> None:
    squares = []
    for seed in range(2):
        positions, truth = deforming(seed=seed)
        found = learn_shape(holes(positions, 0.2), N_BASES, iterations=100)
        covariances = found.shape_covariances()
        np.testing.assert_allclose(covariances, covariances.transpose(0, 1, 3, 2), atol=1e-12)
        assert np.linalg.eigvalsh(covariances).min() > 0
        depth = truth[..., 2:] - truth[..., 2:].mean(axis=1, keepdims=True)
        goal = np.concatenate([truth[..., :2], depth], axis=2)
        off = min((found.shapes() - goal * sign for sign in (1, MIRROR)), key=lambda each: np.sum(each**2))
        squares.append(np.einsum("nji,njik,njk->nj", off, np.linalg.inv(covariances), off).mean() / 3)
    # of two sequences; points of a frame, and frames of a point, err together
    assert 0.6 < np.mean(squares) < 1.7


Numbers = NDArray[np.float64]


def away(found: Numbers, truth: Numbers) -> float:
    """Largest angle rad, up to a rotation of the object and a mirror image in depth."""
    angles = []
    for image in (found, MIRROR[:, None] * found * MIRROR):
        turn = nearest_rotation((image.transpose(0, 2, 1) @ truth).mean(axis=0))
        angles.append(np.linalg.norm(logarithm(image @ turn @ truth.transpose(0, 2, 1)), axis=1).max())
    return float(min(angles))


@pytest.mark.parametrize("n_bases", [1, 2])
def test_rotations_are_those_of_the_object(n_bases: int) -> None:
    random = np.random.default_rng(0)
    n_frames, n_points = 80, 30
    truth = exponential(1.5 * random.standard_normal((n_frames, 3)))
    bases = random.standard_normal((n_bases, n_points, 3))
    bases[1:] *= 0.4
    weights = random.standard_normal((n_frames, n_bases))
    weights[:, 0] = 1
    shapes = np.tensordot(weights, bases, 1)
    positions = (shapes @ truth.transpose(0, 2, 1))[..., :2]
    positions -= positions.mean(axis=1, keepdims=True)
    found = rotations_of_rank(positions, {3 * n_bases})
    np.testing.assert_allclose(np.linalg.det(found), 1)
    assert min(away(each, truth) for each in found) < 1e-3


def test_points_that_do_not_turn_have_no_rotations() -> None:
    still = np.random.default_rng(0).standard_normal((1, 9, 2))
    assert rotations_of_rank(np.repeat(still - still.mean(axis=1), 12, axis=0), {6, 9}) == []


def test_a_turned_over_stretch_of_frames_is_turned_back() -> None:
    time = np.linspace(0, 1, 40)
    random = np.random.default_rng(0)
    flat = random.uniform(-1, 1, (1, N_POINTS, 3)) * [1, 1, 0.1]
    flat -= flat.mean(axis=1, keepdims=True)
    rotations = exponential(np.column_stack([0 * time, 0.3 + 1.0 * time, 0 * time]))
    positions = (flat[0] @ rotations.transpose(0, 2, 1))[..., :2]
    axis = np.linalg.eigh(flat[0].T @ flat[0])[1][:, 0]
    mirrored = np.diag(MIRROR) @ rotations @ (np.eye(3) - 2 * np.outer(axis, axis))
    stretch = slice(12, 25)
    wrong = rotations.copy()
    wrong[stretch] = mirrored[stretch]
    state = em.State(flat, wrong, np.ones(40), np.zeros((40, 2)), 1e-4, np.ones(40))
    tracks = em.Tracks.of(positions)
    found = start.with_smooth_turns(tracks, state)
    assert found is not None
    np.testing.assert_allclose(found.rotations, rotations, atol=1e-12)
    assert start.with_smooth_turns(tracks, replace(state, rotations=rotations)) is None
