"""Tracker of points: given ones, in pictures of exact motion, with a second chain; duplicates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains import PointTracker
from rsmcm.chains.points.point_tracker import (
    PointTable,
    find_coincident_tracks,
    find_duplicates,
    merge_duplicates,
    merge_groups,
)
from rsmcm.chains.points.trajectory import Appearances, PointTrajectory
from rsmcm.inference import (
    BatchIncoming,
    CoordinateAscent,
    Incoming,
    MultiChain,
    Port,
    RecursiveBP,
    Smoothed,
)
from rsmcm.inference.kalman import PointStates
from rsmcm.models import Frame, PointTracks
from rsmcm.models.core.frame import GivenPoints
from rsmcm.models.core.gaussian_message import GaussianMessage, squared_distances
from rsmcm.models.points.point_tracks import PointMessage, noise_of_tracks

from ...support.pictures import WIDTH, Pose, film, hidden_by_a_bar, sliding

Array = NDArray[np.float64]

DT = 1 / 25


def given_frames(tracks: Array) -> list[Frame]:
    """Frames that hold tracks `(n_frames, n_tracks, 2)`, NaN where a track has no point."""
    frames = []
    for number, points in enumerate(tracks, 1):
        seen = np.flatnonzero(~np.isnan(points[:, 0]))
        frames.append(Frame(None, (number - 1) * DT, number, GivenPoints(points[seen], seen)))
    return frames


def circling(
    n_frames: int = 60, n_points: int = 30, noise: float = 0.5, lost: float = 0.1, seed: int = 0
) -> tuple[Array, Array]:
    """Positions of points that go round about (200, 150) px at different radii, and what is seen of them."""
    random = np.random.default_rng(seed)
    angles = random.uniform(0, 2 * np.pi, n_points) + 0.05 * np.arange(n_frames)[:, None]
    radii = random.uniform(20, 100, n_points)
    true = np.stack([200 + radii * np.cos(angles), 150 + radii * np.sin(angles)], axis=2)
    seen = true + random.normal(0, noise, true.shape)
    seen[random.random((n_frames, n_points)) < lost] = np.nan
    return true, seen


def tracked(
    frames: Sequence[Frame], points: PointTracks, tracker: PointTracker | None = None
) -> PointTrajectory:
    model = MultiChain().connect(tracker or PointTracker(), points)
    trajectory: PointTrajectory = CoordinateAscent(model).run(frames)["tracker"]
    return trajectory


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
    # half of the errors, of some 200 independent ones; a factor of 2 in the covariance makes 0.75 or 0.29
    assert 0.3 < inside.mean() < 0.74


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


# --- pictures ---


def pictures(greys: Sequence[NDArray[np.uint8]]) -> list[Frame]:
    return [Frame(grey, DT * t, t + 1) for t, grey in enumerate(greys)]


@dataclass(frozen=True, eq=False)
class Places:
    """Points of the plane by identity, `(n,)` and `(n, 2)`, and the time in s."""

    identities: NDArray[np.int64]
    points: Array
    time: float
    log_prior: float = 0.0


@dataclass(frozen=True)
class PlaneKnown:
    """A chain that knows how the plane moves: it predicts every point where it was seen first."""

    poses: tuple[Pose, ...]
    deviation: float = 0.7
    name: str = "world"  # after the tracker, which has to find points first

    ports = (Port(PointTracks),)

    def _pose(self, time: float) -> Pose:
        return self.poses[round(time / DT)]

    def _message(self, places: Places, time: float, *, groups: bool) -> PointMessage:
        seen = self._pose(time).seen(places.points)
        covariances = np.tile(self.deviation**2 * np.eye(2), (len(seen), 1, 1))
        positions = GaussianMessage.from_moments(places.identities, seen, covariances)
        near = np.abs(places.points[:, None] - places.points).max(axis=2, initial=0) < 1.5
        same_as = places.identities[near.argmax(axis=1)] if groups and len(near) else None
        return PointMessage(positions, same_as=same_as)

    def initial(self, frame: Frame) -> Places:
        return Places(np.zeros(0, np.int64), np.zeros((0, 2)), frame.time)

    def predict(self, state: Places, dt: float) -> Places:
        return replace(state, time=state.time + dt)

    def message(self, state: Places, feature: PointTracks, incoming: Incoming) -> PointMessage:
        return self._message(state, state.time, groups=False)

    def update(self, state: Places, incoming: Incoming) -> Places:
        message = incoming[PointTracks]
        if message.view is None:
            return state
        identities, mean, _ = message.positions.moments
        new = np.isin(identities, message.view.points.identities) & ~np.isin(identities, state.identities)
        together = np.concatenate([state.identities, identities[new]])
        points = np.concatenate([state.points, self._pose(state.time).on_plane(mean[new])])
        order = np.argsort(together)
        return replace(state, identities=together[order], points=points[order])

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: Places | None = None
    ) -> Smoothed[Places]:
        points: dict[int, list[Array]] = {}
        for incoming in incoming_over_time:
            message = incoming[PointTracks]
            identities, mean, covariance = message.positions.moments
            for identity, point, known in zip(
                identities.tolist(), self._pose(incoming.frame.time).on_plane(mean), covariance, strict=True
            ):
                if np.trace(known) < 1:
                    points.setdefault(identity, []).append(point)
        identities = np.array(sorted(points), np.int64)
        medians = np.array([np.median(points[k], axis=0) for k in identities.tolist()])
        return Smoothed(Places(identities, medians, 0.0))

    def messages(
        self, trajectory: Places, feature: PointTracks, incoming_over_time: Sequence[BatchIncoming] = ()
    ) -> list[PointMessage]:
        return [self._message(trajectory, DT * t, groups=True) for t in range(len(self.poses))]


@dataclass
class Finds:
    """Where every point was found: frame and point of the plane."""

    by_identity: dict[int, list[tuple[int, Array]]]

    @classmethod
    def of_run(cls, model: MultiChain, frames: Sequence[Frame], poses: Sequence[Pose]) -> "Finds":
        finds: dict[int, list[tuple[int, Array]]] = {}
        for t, (pose, belief) in enumerate(zip(poses, RecursiveBP(model).run(frames), strict=True)):
            view = belief["tracker"].view
            if view.time == frames[t].time:
                for identity, position in zip(view.points.identities, view.points.positions, strict=True):
                    finds.setdefault(int(identity), []).append((t, pose.on_plane(position)))
        return cls(finds)

    @property
    def errors(self) -> Array:
        """px along either axis, from where the point was found first."""
        return np.concatenate(
            [
                [point - seen[0][1] for _, point in seen[1:]]
                for seen in self.by_identity.values()
                if len(seen) > 1
            ]
        )


def test_points_are_followed_to_fractions_of_a_pixel() -> None:
    poses = sliding(40)
    frames = pictures(film(poses, noise=1.5))
    model = MultiChain().connect(PointTracker(n_points=50), PointTracks())
    finds = Finds.of_run(model, frames, poses)
    lengths = np.array([len(seen) for seen in finds.by_identity.values()])
    assert len(lengths) < 90  # 50 at a time, and some leave the picture
    assert np.median(lengths) > 20
    errors = finds.errors
    right = np.abs(errors).max(axis=1) < 1
    assert right.mean() > 0.99
    assert np.sqrt((errors[right] ** 2).mean()) < 0.2


def test_pictures_from_which_patches_are_cut_are_no_surer_than_the_others() -> None:
    """A patch compared with itself fits without a residual; its place is known no better for it."""
    frames = pictures(film(sliding(4), noise=2.0))
    solution = CoordinateAscent(MultiChain().connect(PointTracker(), PointTracks())).run(frames)
    cut, after = (solution.evidence("points")[t].positions.moments[2] for t in (0, 2))
    ratio = np.median(np.trace(cut, axis1=1, axis2=2)) / np.median(np.trace(after, axis1=1, axis2=2))
    assert 0.5 < ratio < 2.0


BEHIND = 62
"""Frame in which all of the left third is behind the bar's end."""


@pytest.fixture(scope="module")
def hidden() -> tuple[list[Frame], tuple[Pose, ...]]:
    """A bar of 90 px crosses the picture: it hides every point for thirty frames."""
    poses = sliding(70, (0.1, 0.05))
    return pictures(hidden_by_a_bar(film(poses, 2), 8, 3.0, 90)), tuple(poses)


def found_again(finds: Finds) -> float:
    """Share of the points of the first frame's left third that are found when the bar has passed them."""
    began = [seen for seen in finds.by_identity.values() if seen[0][0] == 0 and seen[0][1][0] < WIDTH / 3]
    assert len(began) > 8
    return sum(seen[-1][0] >= BEHIND for seen in began) / len(began)


def test_what_was_hidden_comes_back_as_another_point_alone_and_as_itself_with_a_second_chain(
    hidden: tuple[list[Frame], tuple[Pose, ...]],
) -> None:
    frames, poses = hidden
    tracker, node = PointTracker(n_points=60), PointTracks()
    alone = Finds.of_run(MultiChain().connect(tracker, node), frames, poses)
    both = Finds.of_run(MultiChain().connect(tracker, node).connect(PlaneKnown(poses), node), frames, poses)
    cut = Finds.of_run(
        MultiChain().connect(tracker, node).connect(PlaneKnown(poses), node, feedback=False), frames, poses
    )
    assert found_again(alone) < 0.4
    assert found_again(both) > 0.8
    assert len(both.by_identity) < len(alone.by_identity)
    assert cut.by_identity.keys() == alone.by_identity.keys()  # nothing comes back through a cut edge
    for identity, seen in alone.by_identity.items():
        np.testing.assert_array_equal([t for t, _ in seen], [t for t, _ in cut.by_identity[identity]])
        np.testing.assert_array_equal([p for _, p in seen], [p for _, p in cut.by_identity[identity]])
    right = np.abs(both.errors).max(axis=1) < 1
    assert right.mean() > 0.93


def test_in_later_rounds_points_are_found_wherever_they_are(
    hidden: tuple[list[Frame], tuple[Pose, ...]],
) -> None:
    frames, poses = hidden
    tracker, node = PointTracker(n_points=60), PointTracks()
    alone = CoordinateAscent(MultiChain().connect(tracker, node)).run(frames)["tracker"]
    model = MultiChain().connect(tracker, node).connect(PlaneKnown(poses), node)
    *_, last = CoordinateAscent(model, most_rounds=4).rounds(frames)
    both = last["tracker"]
    assert both.observed.sum() > alone.observed.sum()
    assert np.median(both.observed.sum(axis=0)) > np.median(alone.observed.sum(axis=0))
    assert len(both.identities) < len(alone.identities)
    assert set(both.identities.tolist()) <= set(alone.identities.tolist())
    assert not np.isin(both.absorbed[:, 0], both.identities).any()
    # wrong finds of the first round are undone: those on the bar, which no plane explains
    points = np.stack([pose.on_plane(each) for pose, each in zip(poses, both.position, strict=True)])
    off = [points[seen, k] - np.median(points[seen, k], axis=0) for k, seen in enumerate(both.observed.T)]
    assert (np.abs(np.concatenate(off)).max(axis=1) < 1).mean() > 0.98


def test_of_two_points_on_one_spot_the_younger_ends() -> None:
    (grey,) = film(sliding(1))
    tracker, node = PointTracker(n_points=20), PointTracks()
    model = MultiChain().connect(tracker, node)
    state = next(iter(RecursiveBP(model).run([grey]))).state
    known = state.states["tracker"].known
    again = RecursiveBP(model).step(state, Frame(grey, DT, 2))["tracker"].known
    older, younger = np.flatnonzero(again.unseen == 0)[[3, 7]]
    mean, pixels = known.states.mean.copy(), known.patches.copy()
    mean[younger], pixels[younger] = mean[older], pixels[older]
    moved = replace(known, mean=mean, patches=pixels, first=pixels)
    view = state.states["tracker"].view
    found = view.points.positions.copy()
    found[younger] = found[older]
    view = replace(view, points=replace(view.points, positions=found))
    tracked = replace(state.states["tracker"], known=moved, view=view)
    after = RecursiveBP(model).step(replace(state, states={"tracker": tracked}), Frame(grey, DT, 2))
    alive = after["tracker"].known.alive
    assert alive[older]
    assert not alive[younger]


def test_a_run_goes_on_from_a_file_as_if_nothing_had_been(
    tmp_path: Path, hidden: tuple[list[Frame], tuple[Pose, ...]]
) -> None:
    frames = hidden[0][:24]
    engine = RecursiveBP(MultiChain().connect(PointTracker(n_points=40), PointTracks()))
    whole = list(engine.run(frames))
    engine.save(tmp_path / "state.npz", whole[11].state)
    state, _ = engine.load(tmp_path / "state.npz")
    *_, last = engine.run(frames[12:], state=state)
    one, other = whole[-1]["tracker"], last["tracker"]
    assert one.next_identity == other.next_identity
    assert one.acceleration == other.acceleration
    np.testing.assert_array_equal(one.known.states.mean, other.known.states.mean)
    np.testing.assert_array_equal(one.known.states.covariance, other.known.states.covariance)
    np.testing.assert_array_equal(one.known.patches, other.known.patches)
    np.testing.assert_array_equal(one.view.points.positions, other.view.points.positions)


def test_a_point_of_one_picture_is_no_track() -> None:
    generator = np.random.default_rng(5)
    blots = [generator.integers(0, 255, (15, 20), np.uint8).repeat(8, 0).repeat(8, 1) for _ in range(4)]
    node = PointTracks()
    for images in (blots, [blots[0], *blots]):
        solution = CoordinateAscent(MultiChain().connect(PointTracker(), node)).run(images)
        identities = [message.positions.identities for message in solution.evidence(node)]
        _, counts = np.unique(np.concatenate(identities), return_counts=True)
        assert (counts > 1).all()
    assert len(identities[0]) > 50


PIXELS = np.random.default_rng(0).uniform(0, 255, (6, 5, 5)).astype(np.float32)

pairs = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=12)


def at(identities: list[int], positions: list[list[float]], same_as: list[int] | None = None) -> PointMessage:
    covariances = np.tile(np.eye(2), (len(identities), 1, 1))
    message = GaussianMessage.from_moments(identities, np.array(positions, float).reshape(-1, 2), covariances)
    return PointMessage(message, same_as=None if same_as is None else np.array(same_as))


def trajectory(first: NDArray[np.float32], last: NDArray[np.float32]) -> PointTrajectory:
    n = len(first)
    nothing = np.zeros((1, n), np.bool_)
    flat, square = np.zeros((1, n, 2)), np.zeros((1, n, 2, 2))
    appearances = Appearances(np.arange(n), first, last, np.zeros(n))
    return PointTrajectory(
        np.arange(n), flat, square, nothing, nothing, square, flat, appearances, np.array([[5, 3]]), 0.0
    )


@given(pairs, pairs)
def test_groups_are_those_of_a_graph_and_named_by_their_smallest(
    one: list[tuple[int, int]], other: list[tuple[int, int]]
) -> None:
    graph = nx.Graph()
    graph.add_nodes_from(range(10))
    graph.add_edges_from([*one, *other])
    expected = {
        node: min(part) for part in nx.connected_components(graph) for node in part if node != min(part)
    }
    assert merge_groups(merge_groups({}, one), other) == expected


def test_what_is_said_of_one_point_counts_once() -> None:
    message = at([1, 4, 6], [[0, 0], [5, 5], [9, 9]])
    same = merge_duplicates(message, {6: 4, 1: 0}).positions
    np.testing.assert_array_equal(same.identities, [0, 4])
    np.testing.assert_allclose(same.moments[1], [[0, 0], [5, 5]])
    assert merge_duplicates(message, {}) is message


def test_points_that_others_take_for_one_have_to_look_alike() -> None:
    first = PIXELS.copy()
    last = PIXELS[::-1].copy()
    first[2] = 0.5 * last[0] + 30  # found again as it was lost, in another light
    others = [at([0, 1, 2, 4], [[0, 0]] * 4, [0, 0, 0, 4]), at([0], [[0, 0]])]
    assert find_duplicates(trajectory(first, last), others) == {2: 0, 5: 3}  # what was one before stays so


def test_one_spot_again_and_again_is_one_point() -> None:
    near, far = at([3, 7, 8], [[10, 10], [11, 10], [30, 30]]), at([3, 7, 8], [[10, 10], [20, 10], [30, 30]])
    assert find_coincident_tracks([near] * 5 + [far] * 3, 1.5) == [(3, 7)]
    assert find_coincident_tracks([near] * 4 + [far] * 3, 1.5) == []


def known(identities: list[int], alive: list[bool], unseen: list[float]) -> PointTable:
    n = len(identities)
    states = PointStates.at_rest(np.arange(2.0 * n).reshape(n, 2), 1.0, 1.0)
    return PointTable(
        np.array(identities), states.mean, states.covariance, np.array(alive), np.array(unseen), PIXELS[:n],
        PIXELS[:n], np.zeros(n),
    )  # fmt: skip


def test_points_are_joined_in_order() -> None:
    both = known([2, 9], [True, False], [0.0, 1.0]).merged(known([1, 5], [True, True], [0.0, 0.2]))
    np.testing.assert_array_equal(both.identities, [1, 2, 5, 9])
    np.testing.assert_array_equal(both.alive, [True, True, True, False])
    np.testing.assert_array_equal(both.states.mean[:, 0], [0, 0, 2, 2])
    np.testing.assert_array_equal(both.patches, PIXELS[[0, 0, 1, 1]])


def test_of_the_lost_the_last_are_remembered() -> None:
    points = known([1, 2, 3, 4, 5], [True, False, False, False, True], [9.0, 1.0, 3.0, 1.0, 0.0])
    np.testing.assert_array_equal(points.without_oldest(1).identities, [1, 4, 5])
    np.testing.assert_array_equal(points.without_oldest(2).identities, [1, 2, 4, 5])
    assert points.without_oldest(3) is points
