"""The turning cylinder: exact geometry, and chances that come out as often as they should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.apps.scenes import Cylinder, cylinder
from rsmcm.apps.scenes.turning_cylinder import DRIFT, DRIFT_FRAMES


def within(count: int, total: int, probability: float) -> bool:
    """Whether a count of independent events is no further than 5 deviations from what is expected."""
    return abs(count - total * probability) <= 5 * np.sqrt(total * probability * (1 - probability))


@pytest.fixture(scope="module")
def many() -> Cylinder:
    return cylinder(n_points=400, n_frames=300, p_loose=0.1, p_drift=0.05, p_regain=0.3, seed=7)


def test_cameras_are_orthographic_and_turn_evenly() -> None:
    made = cylinder(n_frames=121, degrees_per_frame=3, noise=0)
    rows = made.cameras[:, :, :3]
    np.testing.assert_allclose(
        rows @ rows.transpose(0, 2, 1), np.broadcast_to(np.eye(2), (121, 2, 2)), atol=1e-12
    )
    np.testing.assert_allclose(made.cameras[120], made.cameras[0], atol=1e-12)  # a whole turn
    np.testing.assert_allclose((rows[1:, 0] * rows[:-1, 0]).sum(axis=1), np.cos(np.radians(3)))
    expected = np.einsum("tka,ia->tik", rows, made.shape) + made.cameras[:, None, :, 3]
    np.testing.assert_allclose(made.positions, expected)
    # the camera looks down: far points of the rim are higher up in the picture (v down)
    forward = np.cross(rows[:, 0], rows[:, 1])
    assert (forward[:, 2] < 0).all()
    assert (rows[:, 1, 2] < 0).all()


def test_nothing_random_without_noise_and_chances() -> None:
    made = cylinder(p_loose=0, p_drift=0, noise=0)
    assert made.visible.all()
    np.testing.assert_array_equal(made.observed, made.positions)
    assert made.tracks().shape == (60, 40, 2)
    assert sorted(made.point_of_track) == list(range(40))
    np.testing.assert_array_equal(made.tracks(), made.observed[:, made.point_of_track])


def test_points_are_lost_and_found_as_often_as_asked(many: Cylinder) -> None:
    assert many.visible[0].all()
    before, after = many.visible[:-1], many.visible[1:]
    assert within(np.count_nonzero(before & ~after), np.count_nonzero(before), 0.1)
    assert within(np.count_nonzero(~before & after), np.count_nonzero(~before), 0.3)


def test_drift_has_its_length_and_lasts_its_time(many: Cylinder) -> None:
    quiet = cylinder(n_points=400, n_frames=300, p_loose=0.1, p_drift=0, p_regain=0.3, seed=7)
    bias = many.observed - quiet.observed
    lengths = np.linalg.norm(bias, axis=2)
    np.testing.assert_allclose(lengths[many.drifting], DRIFT, atol=1e-12)
    np.testing.assert_allclose(lengths[~many.drifting & many.visible], 0, atol=1e-12)
    assert not many.drifting[~many.visible].any()
    # it begins in visible points without bias: within such frames, that often
    steps = np.diff(many.drifting.astype(int), axis=0, prepend=0)
    changed = np.zeros_like(many.drifting)
    changed[1:] = np.linalg.norm(np.diff(bias, axis=0), axis=2) > 1e-9
    starts = many.drifting & ((steps == 1) | changed)
    could = many.visible & (~many.drifting | starts)
    assert within(np.count_nonzero(starts), np.count_nonzero(could), 0.05)
    # and lasts, in points that are never lost
    steady = cylinder(n_points=200, n_frames=100, p_loose=0, p_drift=0.05, seed=3)
    run = np.zeros(200, int)
    for now, then in zip(steady.drifting, steady.drifting[1:], strict=False):
        run = np.where(now, run + 1, 0)
        assert (run[now & ~then] % DRIFT_FRAMES == 0).all()


@settings(max_examples=30, deadline=None)
@given(
    st.integers(1, 12),
    st.integers(1, 25),
    st.floats(0, 1),
    st.floats(0, 1),
    st.floats(0, 1),
    st.integers(0, 99),
)
def test_tracks_are_the_stretches_between_gaps(
    n_points: int, n_frames: int, p_loose: float, p_drift: float, p_regain: float, seed: int
) -> None:
    made = cylinder(n_points, n_frames, p_loose, p_drift, p_regain, seed)
    tracks = made.tracks()
    assert tracks.shape == (n_frames, len(made.point_of_track), 2)
    seen = ~np.isnan(tracks).any(axis=2)
    assert (np.isnan(tracks).all(axis=2) == ~seen).all()
    for track, point in enumerate(made.point_of_track):
        (frames,) = np.nonzero(seen[:, track])
        assert len(frames) == frames[-1] - frames[0] + 1
        np.testing.assert_array_equal(tracks[frames, track], made.observed[frames, point])
        for beside in (frames[0] - 1, frames[-1] + 1):
            assert not 0 <= beside < n_frames or not made.visible[beside, point]
    assert np.count_nonzero(seen) == np.count_nonzero(made.visible)
