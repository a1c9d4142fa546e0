"""Deformable shapes from tracks: against shapes that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.inference.sfm.nonrigid.learning import learn_shape
from rsmcm.inference.sfm.nonrigid.shape import NonrigidShape
from scipy.stats import multivariate_normal

from ....support.deforming import N_BASES, N_FRAMES, N_POINTS, NOISE, deforming, error, holes

Numbers = NDArray[np.float64]


@given(st.integers(0, 1000), st.sampled_from([0.0, 0.3]))
@settings(max_examples=3, deadline=None)
def test_likelihood_never_falls(seed: int, missing: float) -> None:
    positions, _ = deforming(n_frames=12, seed=seed)
    found = learn_shape(holes(positions, missing, seed), N_BASES, iterations=30, tolerance=0)
    gains = np.diff(found.history)
    assert (gains > -1e-9 * np.abs(found.history[:-1])).all()


# --- whole shapes -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def learned() -> NonrigidShape:
    return learn_shape(deforming()[0], N_BASES)


@pytest.mark.parametrize(("missing", "bound"), [(0.0, 0.02), (0.3, 0.025)])
def test_shapes_are_recovered_also_where_points_were_not_seen(missing: float, bound: float) -> None:
    positions, truth = deforming()
    found = learn_shape(holes(positions, missing), N_BASES, iterations=100)
    # noise is 1 % of the size; depth of what deforms and turns at once is known less well
    assert error(found.shapes(), truth) < bound
    # the most likely noise is too small by the numbers fitted: 6 of each pose, 3 of each point of each basis
    count = 2 * N_FRAMES * N_POINTS * (1 - missing)
    expected = NOISE * np.sqrt(1 - (6 * N_FRAMES + 3 * N_POINTS * N_BASES) / count)
    assert found.noise == pytest.approx(expected, rel=0.05)  # its deviation by chance is 2 %
    assert found.rmse < found.noise


def test_conventions_of_the_model(learned: NonrigidShape) -> None:
    positions, _ = deforming()
    mean = learned.bases[0]
    assert np.sqrt(np.mean(np.sum(mean[:, :2] ** 2, axis=1))) == pytest.approx(1)
    np.testing.assert_allclose(learned.bases.mean(axis=1), 0, atol=1e-12)
    mean_rotation = learned.rotations.mean(axis=0)
    np.testing.assert_allclose(mean_rotation, mean_rotation.T, atol=1e-9)  # its nearest rotation is 1
    np.testing.assert_allclose(np.linalg.det(learned.rotations), 1)
    np.testing.assert_allclose(learned.weights.mean(axis=0), 0, atol=0.02)
    # means of posteriors vary less than the weights
    np.testing.assert_allclose(learned.weights.std(axis=0), 1, atol=0.05)
    # true shape: margin behind the middle, as the true one
    margin = np.sum(mean[:, :2] ** 2, axis=1)
    assert np.corrcoef(mean[:, 2], margin)[0, 1] > 0.8
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


def test_order_of_points_place_and_unit_do_not_matter(learned: NonrigidShape) -> None:
    positions, _ = deforming()
    order = np.random.default_rng(0).permutation(N_POINTS)
    found = learn_shape(3 * positions[:, order] + [700, -90], N_BASES)
    # EM stops a little short of the optimum, and rounding takes it there by other ways
    assert error(found.shapes(), 3 * learned.shapes()[:, order]) < 5e-4
    assert found.noise == pytest.approx(3 * learned.noise, rel=5e-4)


def test_same_tracks_give_the_same_bytes() -> None:
    positions, _ = deforming(n_frames=15)
    one, other = (learn_shape(positions, N_BASES, iterations=20) for _ in range(2))
    assert one.bases.tobytes() == other.bases.tobytes()


def test_depth_that_the_motion_does_not_show_is_of_usual_size() -> None:
    positions, _ = deforming(turn=0.04, noise=1.0)
    mean = learn_shape(positions, N_BASES).bases[0]
    depth = np.sqrt(np.mean(mean[:, 2] ** 2)) / np.sqrt(np.mean(mean[:, :2] ** 2))
    assert 0.1 < depth < 2


def test_things_that_do_not_move_or_deform_have_modes_of_nothing() -> None:
    positions, _ = deforming(n_frames=1, noise=0)
    found = learn_shape(np.repeat(positions, 6, axis=0), 2)
    assert found.rmse < 0.05
    assert np.abs(found.bases[1, :, :2]).max() < 0.01


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
    ],
)
def test_tracks_that_cannot_be_learned_from(tracks: Numbers, bases: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        learn_shape(tracks, bases)
