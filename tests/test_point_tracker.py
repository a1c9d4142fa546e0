"""Tracker of single points: with points that are given, in pictures of exact motion, alone and told by another."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains import PointTracker
from rsmcm.inference import CoordinateAscent, MultiChain, RecursiveBP
from rsmcm.inference.point_trajectory import PointTrajectory
from rsmcm.inference.protocols import BatchIncoming, Incoming
from rsmcm.models import Frame, PointTracks
from rsmcm.models.frame import GivenPoints
from rsmcm.models.gaussian_message import GaussianMessage
from rsmcm.models.point_tracks import PointMessage, noise_of_tracks

Numbers = NDArray[np.float64]

DT = 1 / 25


def given_frames(tracks: Numbers) -> list[Frame]:
    """Frames that hold tracks `(n_frames, n_tracks, 2)`, NaN where a track has no point."""
    frames = []
    for number, points in enumerate(tracks, 1):
        seen = np.flatnonzero(~np.isnan(points[:, 0]))
        frames.append(Frame(None, (number - 1) * DT, number, GivenPoints(points[seen], seen)))
    return frames


def circling(
    n_frames: int = 60, n_points: int = 30, noise: float = 0.5, lost: float = 0.1, seed: int = 0
) -> tuple[Numbers, Numbers]:
    """True positions of points that go round about (200, 150) px at different radii, and what is seen of them."""
    random = np.random.default_rng(seed)
    angles = random.uniform(0, 2 * np.pi, n_points) + 0.05 * np.arange(n_frames)[:, None]
    radii = random.uniform(20, 100, n_points)
    true = np.stack([200 + radii * np.cos(angles), 150 + radii * np.sin(angles)], axis=2)
    seen = true + random.normal(0, noise, true.shape)
    seen[random.random((n_frames, n_points)) < lost] = np.nan
    return true, seen


def tracked(frames: Sequence[Frame], points: PointTracks, tracker: PointTracker | None = None) -> PointTrajectory:
    model = MultiChain().connect(tracker or PointTracker(), points)
    trajectory: PointTrajectory = CoordinateAscent(model).run(frames)["tracker"]
    return trajectory


def squared_distances(off: Numbers, covariance: Numbers) -> Numbers:
    distances: Numbers = (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=-1)
    return distances


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_given_tracks_are_smoothed_alike_in_any_unit(scale: float) -> None:
    true, seen = circling()
    frames = given_frames(scale * seen)
    noise = noise_of_tracks(frames)
    assert noise == pytest.approx(0.5 * scale, rel=0.1)
    found = tracked(frames, PointTracks(noise=noise))
    observed = ~np.isnan(seen[:, :, 0])
    np.testing.assert_array_equal(found.observed, observed)
    np.testing.assert_array_equal(found.identities, np.arange(30))
    assert found.alive.mean() > 0.99  # gaps are short
    error = found.position / scale - true
    assert np.sqrt((error[observed] ** 2).mean()) < 0.5 * 0.7
    inside = squared_distances(error, found.covariance / scale**2)[found.alive] < 2 * np.log(2)
    assert 0.35 < inside.mean() < 0.65  # half of the errors, which depend on their neighbours in time


def test_filter_follows_given_points_and_keeps_their_numbers() -> None:
    true, seen = circling(lost=0.3)
    frames = given_frames(seen)
    model = MultiChain().connect(PointTracker(), PointTracks(noise=0.5))
    errors = []
    for frame, places, belief in zip(frames, true, RecursiveBP(model).run(frames), strict=True):
        state = belief["tracker"]
        assert frame.points is not None
        assert set(frame.points.identities) <= set(state.known.identities[state.known.alive])
        off = state.known.states.position - places[state.known.identities]
        errors.append(off[(state.known.unseen == 0) & state.known.alive])
    assert np.sqrt((np.concatenate(errors[10:]) ** 2).mean()) < 0.5  # better than the points that are given


def test_what_a_frame_says_never_comes_back_to_it() -> None:
    _, seen = circling(lost=0.0)
    frames = given_frames(seen)
    moved = list(frames)
    points = frames[20].points
    assert points is not None
    moved[20] = replace(frames[20], points=replace(points, positions=points.positions + 0.1))
    tracker, points_node = PointTracker(acceleration=500.0), PointTracks(noise=0.5)
    before, after = (tracker.messages(tracked(each, points_node, tracker), points_node) for each in (frames, moved))
    for time in (19, 20, 21):
        _, one, _ = before[time].positions.moments
        _, other, _ = after[time].positions.moments
        assert np.allclose(one, other, atol=1e-6) == (time == 20)


def test_messages_and_evidence_make_the_smoothed_track() -> None:
    _, seen = circling()
    frames, node = given_frames(seen), PointTracks(noise=0.5)
    model = MultiChain().connect(PointTracker(), node)
    solution = CoordinateAscent(model).run(frames)
    trajectory = solution["tracker"]
    for time, belief in enumerate(solution[node]):
        identities, mean, covariance = belief.positions.moments
        np.testing.assert_allclose(mean, trajectory.position[time, identities], atol=1e-6)
        np.testing.assert_allclose(covariance, trajectory.covariance[time, identities], atol=1e-6)


def test_a_point_seen_once_says_nothing_elsewhere() -> None:
    tracks = np.full((20, 5, 2), np.nan)
    tracks[:, :4] = np.arange(4)[:, None] * 10.0 + np.arange(20)[:, None, None]
    tracks[7, 4] = 5.0
    trajectory = tracked(given_frames(tracks), PointTracks(noise=0.1))
    assert trajectory.alive[7, 4]
    assert not trajectory.information[:, 4].any()
    assert trajectory.alive[:, :4].all()


def test_missing_frames_and_frames_without_points() -> None:
    true, seen = circling(lost=0.0)
    seen[30:32] = np.nan
    frames = given_frames(seen)
    frames[40] = Frame(None, frames[40].time, frames[40].number)
    trajectory = tracked(frames, PointTracks(noise=0.5))
    gone = [30, 31, 40]
    assert not trajectory.observed[gone].any()
    assert trajectory.alive[gone].all()
    assert np.sqrt(((trajectory.position - true)[gone] ** 2).mean()) < 1.0


def test_a_jump_does_not_make_points_restless() -> None:
    _, seen = circling(noise=0.3, lost=0.0)
    jumped = seen.copy()
    jumped[25:, ::5] += 30.0
    calm, shaken = (
        tracked(given_frames(each), PointTracks(noise=0.3)).covariance[10, 1, 0, 0] for each in (seen, jumped)
    )
    assert shaken == pytest.approx(calm, rel=0.2)
