"""Tracker of single points: given ones, in pictures of exact motion, and with a chain that knows more."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import PointTracker
from rsmcm.chains.points.trajectory import PointTrajectory
from rsmcm.inference import (
    BatchIncoming,
    CoordinateAscent,
    Incoming,
    MultiChain,
    Port,
    RecursiveBP,
    Smoothed,
)
from rsmcm.models import Frame, PointTracks
from rsmcm.models.core.frame import GivenPoints
from rsmcm.models.core.gaussian_message import GaussianMessage, squared_distances
from rsmcm.models.points.point_tracks import PointMessage, noise_of_tracks

from ...support.pictures import WIDTH, Pose, film, hidden_by_a_bar, sliding

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
    before, after = (
        tracker.messages(tracked(each, points_node, tracker), points_node) for each in (frames, moved)
    )
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


# --- pictures ---


def pictures(greys: Sequence[NDArray[np.uint8]]) -> list[Frame]:
    return [Frame(grey, DT * t, t + 1) for t, grey in enumerate(greys)]


@dataclass(frozen=True, eq=False)
class Places:
    """Points of the plane by identity, `(n,)` and `(n, 2)`, and the time in s."""

    identities: NDArray[np.int64]
    points: Numbers
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
        points: dict[int, list[Numbers]] = {}
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

    by_identity: dict[int, list[tuple[int, Numbers]]]

    @classmethod
    def of_run(cls, model: MultiChain, frames: Sequence[Frame], poses: Sequence[Pose]) -> "Finds":
        finds: dict[int, list[tuple[int, Numbers]]] = {}
        for t, (pose, belief) in enumerate(zip(poses, RecursiveBP(model).run(frames), strict=True)):
            view = belief["tracker"].view
            if view.time == frames[t].time:
                for identity, position in zip(view.points.identities, view.points.positions, strict=True):
                    finds.setdefault(int(identity), []).append((t, pose.on_plane(position)))
        return cls(finds)

    @property
    def errors(self) -> Numbers:
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


def test_smoothed_tracks_are_better_and_know_how_good_they_are() -> None:
    poses = sliding(40)
    frames = pictures(film(poses, 1, noise=4.0))
    node = PointTracks()
    solution = CoordinateAscent(MultiChain().connect(PointTracker(n_points=50), node)).run(frames)
    trajectory = solution["tracker"]
    raw, smooth, distances = [], [], []
    for time, (pose, evidence) in enumerate(zip(poses, solution.evidence(node), strict=True)):
        identities, mean, _ = evidence.positions.moments
        place = np.searchsorted(trajectory.identities, identities)
        first = trajectory.observed.argmax(axis=0)[place]
        # a point is where its patch was cut out, which the first find says exactly
        origin = np.array(
            [poses[t].on_plane(trajectory.position[t, k]) for t, k in zip(first, place, strict=True)]
        )
        seen_once = trajectory.observed[:, place].sum(axis=0) < 5
        off, better = mean - pose.seen(origin), trajectory.position[time, place] - pose.seen(origin)
        use = ~seen_once & (np.abs(off).max(axis=1) < 1) & (first < time)
        raw.append(off[use])
        smooth.append(better[use])
        distances.append(squared_distances(better[use], trajectory.covariance[time, place][use]))
    before, after = (np.sqrt((np.concatenate(each) ** 2).mean()) for each in (raw, smooth))
    assert after < before
    assert np.median(np.concatenate(distances)) < 5 * 2 * np.log(2)


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
    assert found_again(alone) < 0.2
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
    assert both.observed.sum() > 1.1 * alone.observed.sum()
    assert np.median(both.observed.sum(axis=0)) > 1.2 * np.median(alone.observed.sum(axis=0))
    assert len(both.identities) < len(alone.identities)
    assert set(both.identities.tolist()) <= set(alone.identities.tolist())
    assert len(both.absorbed)
    assert not np.isin(both.absorbed[:, 0], both.identities).any()
    # wrong finds of the first round are undone: those on the bar, which no plane explains
    points = np.stack([pose.on_plane(each) for pose, each in zip(poses, both.position, strict=True)])
    off = [points[seen, k] - np.median(points[seen, k], axis=0) for k, seen in enumerate(both.observed.T)]
    assert (np.abs(np.concatenate(off)).max(axis=1) < 1).mean() > 0.98


def test_identities_are_never_used_twice_and_runs_are_repeatable() -> None:
    poses = sliding(30, (3.0, 1.0))
    frames = pictures(film(poses, 3))
    model = MultiChain().connect(PointTracker(n_points=40), PointTracks())
    first = [belief["tracker"] for belief in RecursiveBP(model).run(frames)]
    second = [belief["tracker"] for belief in RecursiveBP(model).run(frames)]
    gone: set[int] = set()
    for one, other in zip(first, second, strict=True):
        alive = set(one.known.identities[one.known.alive].tolist())
        assert not alive & gone
        gone = set(range(one.next_identity)) - alive
        assert (one.known.states.mean == other.known.states.mean).all()
        np.testing.assert_array_equal(one.known.patches, other.known.patches)
    assert first[-1].next_identity > 40


def test_of_two_points_on_one_spot_the_younger_ends() -> None:
    (grey,) = film(sliding(1))
    tracker, node = PointTracker(n_points=20), PointTracks()
    model = MultiChain().connect(tracker, node)
    state = next(iter(RecursiveBP(model).run([grey]))).state
    known = state.states["tracker"].known
    mean, pixels = known.states.mean.copy(), known.patches.copy()
    mean[7], pixels[7] = mean[3], pixels[3]
    moved = replace(known, mean=mean, patches=pixels, first=pixels)
    view = state.states["tracker"].view
    found = view.points.positions.copy()
    found[7] = found[3]
    view = replace(view, points=replace(view.points, positions=found))
    tracked = replace(state.states["tracker"], known=moved, view=view)
    after = RecursiveBP(model).step(replace(state, states={"tracker": tracked}), Frame(grey, DT, 2))
    alive = after["tracker"].known.alive
    assert alive[3]
    assert not alive[7]


def test_missing_frames_are_bridged() -> None:
    poses = sliding(30)
    frames = pictures(film(poses, 6))
    for t in (0, 1, 14, 15, 16):
        frames[t] = Frame(None, frames[t].time, t + 1)
    tracker, node = PointTracker(n_points=40), PointTracks()
    states = [
        belief.states.get("tracker")
        for belief in RecursiveBP(MultiChain().connect(tracker, node)).run(frames)
    ]
    assert states[0] is states[1] is None
    before, after = states[13].known, states[17].known
    assert np.isin(before.identities[before.alive], after.identities[after.alive]).mean() > 0.8
    trajectory = tracked(frames, node, tracker)
    assert not trajectory.observed[[0, 1, 14, 15, 16]].any()
    assert trajectory.alive[15].sum() > 25


@pytest.mark.parametrize("steps", [(0.04,) * 10, (0.1, 0.3), (0.4, 0.0)])
def test_some_steps_are_one_long_step(steps: tuple[float, ...]) -> None:
    tracker = PointTracker(n_points=40)
    *_, last = RecursiveBP(MultiChain().connect(tracker, PointTracks())).run(film(sliding(5)))
    once = several = last[tracker]
    once = tracker.predict(once, sum(steps))
    for dt in steps:
        several = tracker.predict(several, dt)
    assert once.since_corner_search == pytest.approx(several.since_corner_search, rel=1e-12)
    np.testing.assert_allclose(once.known.unseen, several.known.unseen, rtol=1e-12)
    np.testing.assert_allclose(once.known.states.mean, several.known.states.mean, rtol=1e-9)
    np.testing.assert_allclose(
        once.known.states.covariance, several.known.states.covariance, rtol=1e-9, atol=1e-9
    )


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
