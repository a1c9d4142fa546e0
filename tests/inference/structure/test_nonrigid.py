"""Deformable shapes from tracks: against dense Gaussians, finite differences, and shapes that are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.inference.structure import nonrigid_em as em
from rsmcm.inference.structure import nonrigid_start
from rsmcm.inference.structure.nonrigid import NonrigidShape, learn_shape, triangles_in_front
from rsmcm.models.numerics.rotations import exponential
from scipy.stats import multivariate_normal

Numbers = NDArray[np.float64]

N_FRAMES, N_POINTS, N_BASES = 60, 20, 3
NOISE = 0.5  # px
SIZE = 50.0  # px

MIRROR = np.array([1.0, 1.0, -1.0])


def deforming(
    n_frames: int = N_FRAMES, turn: float = 0.6, noise: float = NOISE, seed: int = 0
) -> tuple[Numbers, Numbers]:
    """Tracks `(n_frames, n_points, 2)` px of a bent sheet that turns and deforms, and its true 3-D shapes."""
    random = np.random.default_rng(seed)
    across = random.uniform(-1, 1, (N_POINTS, 2))
    bases = np.zeros((N_BASES, N_POINTS, 3))
    bases[0] = np.column_stack([across, 0.8 * np.sum(across**2, axis=1)])
    bases[1:] = 0.12 * random.standard_normal((N_BASES - 1, N_POINTS, 3))
    weights = random.standard_normal((n_frames, N_BASES - 1))
    time = np.linspace(0, 1, n_frames)
    angles = turn * np.column_stack([np.sin(7 * time), np.cos(5 * time), 0.5 * np.sin(4 * time)])
    scales = SIZE * (1 + 0.1 * np.sin(9 * time))
    shapes = bases[0] + np.tensordot(weights, bases[1:], 1)
    seen = scales[:, None, None] * (shapes @ exponential(angles).transpose(0, 2, 1))
    seen[..., :2] += np.column_stack([200 + 30 * time, 150 - 20 * time])[:, None]
    return seen[..., :2] + noise * random.standard_normal((n_frames, N_POINTS, 2)), seen


def holes(tracks: Numbers, share: float, seed: int = 1) -> Numbers:
    """Tracks of which a share is missing at random, but not in the first frames."""
    partial = tracks.copy()
    hidden = np.random.default_rng(seed).random(tracks.shape[:2]) < share
    hidden[:3] = False
    partial[hidden] = np.nan
    return partial


def error(found: Numbers, truth: Numbers) -> float:
    """Normalised 3-D error about the centroids, up to one mirror image."""
    one, other = (shapes - shapes.mean(axis=1, keepdims=True) for shapes in (found, truth))
    size = np.linalg.norm(other, axis=(1, 2))
    return min(
        float(np.mean(np.linalg.norm(one * image - other, axis=(1, 2)) / size)) for image in (1.0, MIRROR)
    )


def some_state(missing: float = 0.3) -> tuple[em.Tracks, em.State]:
    """A state that is not at any optimum, and tracks with gaps."""
    positions, _ = deforming(n_frames=8)
    partial = holes(positions, missing)
    partial -= np.nanmean(partial, axis=1, keepdims=True)
    partial /= SIZE
    random = np.random.default_rng(2)
    bases = 0.3 * random.standard_normal((N_BASES, N_POINTS, 3))
    bases[0, :, :2] = partial[0]
    state = em.State(
        bases,
        exponential(0.2 * random.standard_normal((8, 3))),
        random.uniform(0.9, 1.1, 8),
        0.1 * random.standard_normal((8, 2)),
        0.04,
        np.full(8, em.FIRST_DAMPING),
    )
    return em.Tracks.of(partial), state


# --- steps --------------------------------------------------------------------------------------------------


def test_weights_and_likelihood_are_those_of_the_joint_gaussian() -> None:
    tracks, state = some_state()
    found = em.e_step(state, em.point_sums(tracks, state.bases))
    for frame, axes in enumerate(state.seen_axes):
        seen = tracks.seen[frame] > 0
        matrix = np.stack([(basis[seen] @ axes.T).ravel() for basis in state.bases], axis=1)
        mean = matrix[:, 0] + np.tile(state.translations[frame], seen.sum())
        modes = matrix[:, 1:]
        covariance = modes @ modes.T + state.noise * np.eye(len(mean))
        observed = tracks.positions[frame, seen].ravel()
        gain = modes.T @ np.linalg.inv(covariance)
        assert found.log_likelihood[frame] == pytest.approx(
            multivariate_normal(mean, covariance).logpdf(observed), rel=1e-10
        )
        np.testing.assert_allclose(found.mean[frame], gain @ (observed - mean), atol=1e-10)
        np.testing.assert_allclose(found.covariance[frame], np.eye(N_BASES - 1) - gain @ modes, atol=1e-10)


def moved(state: em.State, changes: Numbers) -> em.State:
    """Poses changed by `(6,)`: rotation vector, logarithm of scale, translation."""
    n = len(state.scales)
    return replace(
        state,
        rotations=exponential(np.tile(changes[:3], (n, 1))) @ state.rotations,
        scales=state.scales * np.exp(changes[3]),
        translations=state.translations + changes[4:],
    )


def test_poses_climb_to_where_the_likelihood_without_weights_is_flat() -> None:
    tracks, state = some_state()
    sums = em.point_sums(tracks, state.bases)
    found = em.e_step(state, sums)

    def slopes(at: em.State) -> Numbers:
        """`(6, n_frames)` by central differences; their rounding error is about 1e-6."""
        step = 1e-5
        ends = (
            [em.e_step(moved(at, sign * step * axis), sums).log_likelihood for sign in (1, -1)]
            for axis in np.eye(6)
        )
        return np.array([(up - down) / (2 * step) for up, down in ends])

    before = np.abs(slopes(state)).max()
    for _ in range(60):
        likelihood = found.log_likelihood
        state, found = em.pose_step(state, sums, found)
        assert (found.log_likelihood >= likelihood).all()
    assert before > 10
    assert np.abs(slopes(state)).max() < 1e-3
    again = em.e_step(state, sums)
    np.testing.assert_allclose(found.mean, again.mean, atol=1e-12)
    np.testing.assert_allclose(found.products, again.products, atol=1e-12)


def test_bases_are_where_the_expected_squares_with_the_prior_are_least() -> None:
    tracks, state = some_state()
    found = em.e_step(state, em.point_sums(tracks, state.bases))
    # without the change back to N(0, I)
    found = replace(found, mean=found.mean - found.mean.mean(axis=0))
    second = found.mean.T @ found.mean / 8 + found.covariance.mean(axis=0)
    prior = em.basis_covariance(state)
    after, _ = em.shape_step(state, tracks, found, prior)
    after.bases[1:] = np.tensordot(np.linalg.inv(np.linalg.cholesky(second)).T, after.bases[1:], 1)

    def cost(bases: Numbers) -> float:
        extended = found.extended
        shapes = np.tensordot(extended, bases, 1)
        axes = state.seen_axes
        residual = tracks.positions - state.translations[:, None] - shapes @ axes.transpose(0, 2, 1)
        seen = np.einsum("kja,nca->nkjc", bases[1:], axes)
        spread = np.einsum("nkl,nkjc,nljc->nj", found.covariance, seen, seen)
        squares = float(np.sum(tracks.seen * (np.sum(residual**2, axis=2) + spread)))
        return squares / (2 * state.noise) - em.log_prior(bases, prior)

    least = cost(after.bases)
    assert least < cost(state.bases)
    random = np.random.default_rng(0)
    for _ in range(20):
        change = 1e-4 * random.standard_normal(after.bases.shape)
        up, down = cost(after.bases + change), cost(after.bases - change)
        assert min(up, down) > least
        # a quadratic has its least value halfway; elsewhere the two differ more than they rise
        assert abs(up - down) < 1e-4 * (up + down - 2 * least)


@given(st.integers(0, 1000), st.sampled_from([0.0, 0.3]))
@settings(max_examples=5, deadline=None)
def test_likelihood_never_falls(seed: int, missing: float) -> None:
    positions, _ = deforming(n_frames=12, seed=seed)
    found = learn_shape(holes(positions, missing, seed), N_BASES, iterations=30, tolerance=0)
    gains = np.diff(found.history)
    assert (gains > -1e-9 * np.abs(found.history[:-1])).all()


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
    found = nonrigid_start.smoothed(tracks, state)
    assert found is not None
    np.testing.assert_allclose(found.rotations, rotations, atol=1e-12)
    assert nonrigid_start.smoothed(tracks, replace(state, rotations=rotations)) is None


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
    assert error(found.shapes(), 3 * learned.shapes()[:, order]) < 1e-4
    assert found.noise == pytest.approx(3 * learned.noise, rel=1e-4)


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


def test_points_on_a_line_have_no_triangles() -> None:
    line = np.column_stack([np.arange(8.0), 2 * np.arange(8.0), np.zeros(8)])
    with pytest.raises(ValueError, match="points on a line"):
        triangles_in_front(line)
