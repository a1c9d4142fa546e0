"""Trajectories of objects: smoothing against known motions, joins, and the batch chain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains import ObjectTrajectories
from rsmcm.chains.objects import object_trajectories
from rsmcm.chains.objects.object_trajectories import (
    ArrivalModel,
    Boxes,
    Motion,
    find_joins,
    join,
    messages_of,
    smooth_tracks,
)
from rsmcm.inference import BatchIncoming, CoordinateAscent, MultiChain, Port, Smoothed
from rsmcm.models import Frame, ObjectBoxes
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.objects.box_message import BoxMessage

MOTION = Motion(0.4, 0.1, 1.0)
SIZE = (400, 600)
RATE = 25
ARRIVALS = ArrivalModel(SIZE, 0.2, 3.0)
TIMES = np.arange(200) / RATE


def walk(
    identity: int,
    frames: Sequence[int] | NDArray[np.int64],
    start: tuple[float, float],
    velocity: tuple[float, float] = (50.0, 0.0),
    height: float = 60.0,
    noise: float = 0.0,
) -> Boxes:
    """Somebody who walks straight on, seen in these frames; `start` is in frame 0."""
    at = np.asarray(frames, np.int64)
    random = np.random.default_rng(identity)
    means = np.column_stack(
        [start[axis] + velocity[axis] * TIMES[at] for axis in range(2)]
        + [np.full(len(at), 0.4 * height), np.full(len(at), height)]
    )
    means += noise * random.normal(size=means.shape)
    variances = np.full(means.shape, max(noise, 1.0) ** 2)
    return Boxes(at, np.full(len(at), identity), means, variances)


def test_smoothing_follows_a_straight_walk_through_gaps() -> None:
    seen = np.r_[5:40, 70:120]
    (track,) = smooth_tracks([walk(3, seen, (100, 200), (40, 10))], TIMES, MOTION)
    truth = walk(3, np.arange(5, 120), (100, 200), (40, 10))
    found = track.boxes()
    assert (track.first, track.last, track.identity) == (5, 119, 3)
    np.testing.assert_array_equal(np.flatnonzero(track.seen) + 5, seen)
    np.testing.assert_array_equal(found.frames, truth.frames)
    np.testing.assert_allclose(found.means, truth.means, atol=0.3)
    hidden = found.variances[50 - 5]
    assert (hidden[:2] > 2 * found.variances[30 - 5][:2]).all()
    # in a longer gap it is not reported in the middle
    (track,) = smooth_tracks([walk(3, np.r_[5:40, 115:150], (100, 200), (40, 10))], TIMES, MOTION)
    reported = set(track.boxes().frames[track.reported()].tolist())
    assert {*range(5, 42), *range(113, 150)} <= reported
    assert not reported & set(range(70, 85))


def test_smoothing_takes_noise_away_and_says_how_much_is_left() -> None:
    errors, stated, raw = [], [], []
    for seed in range(20):
        seen = walk(seed, np.arange(0, 100), (100, 200), noise=3.0)
        truth = walk(seed, np.arange(0, 100), (100, 200))
        found = smooth_tracks([seen], TIMES, MOTION)[0].boxes()
        errors.append(found.means - truth.means)
        raw.append(seen.means - truth.means)
        stated.append(found.variances)
    assert np.square(errors).mean() < 0.25 * np.square(raw).mean()
    nees = np.mean(np.square(errors) / stated)
    assert 0.2 < nees < 1.2  # straight walks vary less than the model expects


def test_what_comes_out_of_nothing_is_reported_from_its_first_pixel_on() -> None:
    track = walk(1, range(60), (100, 200))
    track.means[:, 2:] = np.maximum(np.outer(np.arange(60) - 10, [0.4, 1.0]), 0.1)
    (smoothed,) = smooth_tracks([track], TIMES, MOTION)
    assert smoothed.boxes().means[:, 2:].min() < 0
    reported = smoothed.reported()
    assert smoothed.boxes().only(reported).means[:, 2:].min() > 0
    assert reported[15:].all()


def test_tracks_smoothed_together_are_as_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    times = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.06, 200))
    spans = [(5, 120), (0, 200), (60, 61), (30, 90), (190, 200), (2, 117)]
    tracks = [
        walk(identity, [t for t in range(first, end) if t % 5 or t == first], (100, 200), noise=3.0)
        for identity, (first, end) in enumerate(spans)
    ]
    alone = [smooth_tracks([track], times, MOTION)[0] for track in tracks]
    for most in (10**6, 250):  # in one batch, and in four
        monkeypatch.setattr(object_trajectories, "MOST_ROWS", most)
        for one, other in zip(alone, smooth_tracks(tracks, times, MOTION), strict=True):
            assert (one.first, one.last, one.identity) == (other.first, other.last, other.identity)
            np.testing.assert_array_equal(one.seen, other.seen)
            for states, same in ((one.feet, other.feet), (one.sizes, other.sizes)):
                np.testing.assert_allclose(states.mean, same.mean, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(states.covariance, same.covariance, rtol=1e-9, atol=1e-9)
    assert smooth_tracks([], times, MOTION) == []


def test_who_is_lost_behind_something_is_the_same_afterwards() -> None:
    one, other = walk(1, range(20, 60), (100, 200)), walk(2, range(90, 150), (100, 200))
    tracks = smooth_tracks([one, other], TIMES, MOTION)
    next_of = find_joins(tracks, TIMES, MOTION, ARRIVALS)
    assert next_of == {0: 1}
    together = join(Boxes.together([one, other]), tracks, next_of)
    assert set(together.identities.tolist()) == {1}
    np.testing.assert_array_equal(together.frames, np.r_[20:60, 90:150])


def test_others_are_others() -> None:
    lost = walk(1, range(20, 60), (100, 200))
    left = walk(2, range(0, 60), (480, 300))  # at the edge in frame 60
    for track, new in (
        (lost, walk(5, range(90, 150), (380, 200))),  # elsewhere
        (lost, walk(5, range(90, 150), (712, 200), (-120, 0))),  # where he would be, running back
        (lost, walk(5, range(90, 150), (100, 200), height=120)),  # twice as large
        (lost, walk(5, range(150, 190), (100, 200))),  # after too long
        (left, walk(5, range(100, 150), (950, 300), (-90, 0))),  # somebody comes, fast, where he went
    ):
        tracks = smooth_tracks([track, new], TIMES, MOTION)
        assert find_joins(tracks, TIMES, MOTION, ARRIVALS) == {}


def test_two_who_are_hidden_at_once_are_told_apart() -> None:
    """Each alone could be either; together only one way is likely."""
    ends = [walk(1, range(0, 50), (100, 200)), walk(2, range(0, 50), (100, 226))]
    begins = [walk(3, range(70, 120), (100, 213)), walk(4, range(70, 120), (100, 232))]
    tracks = smooth_tracks([*ends, *begins], TIMES, MOTION)
    assert find_joins(tracks, TIMES, MOTION, ARRIVALS) == {0: 2, 1: 3}


def test_boxes_become_messages_and_back() -> None:
    boxes = Boxes.together([walk(4, range(3, 9), (100, 200)), walk(1, range(5, 7), (300, 100), noise=2.0)])
    assert [track.identities[0] for track in boxes.tracks()] == [1, 4]
    messages = messages_of(boxes, 12)
    assert [len(message.objects) for message in messages] == [0, 0, 0, 1, 1, 2, 2, 1, 1, 0, 0, 0]
    again = Boxes.of([message.objects for message in messages])
    np.testing.assert_array_equal(again.frames, boxes.frames)
    np.testing.assert_array_equal(again.identities, boxes.identities)
    np.testing.assert_allclose(again.means, boxes.means)
    np.testing.assert_allclose(again.variances, boxes.variances)
    assert len(Boxes.of([])) == 0


@pytest.mark.parametrize("place", [(100, 200), (20, 200), (590, 200), (300, 62), (300, 399)])
def test_the_edge_is_near_where_a_box_touches_it(place: tuple[float, float]) -> None:
    tracks = [walk(1, range(10), place, (0.0, 0.0)), walk(2, range(10), (100, 200), (0.0, 0.0))]
    track, inside = smooth_tracks(tracks, TIMES, MOTION)
    assert ARRIVALS.at_edge(track, 0) == (place != (100, 200))
    assert ARRIVALS.log_new(track) >= ARRIVALS.log_new(inside)
    assert ARRIVALS.log_back(track) <= ARRIVALS.log_back(inside)


N_FRAMES = 100
BOXES = ObjectBoxes()


@dataclass(frozen=True)
class Nothing:
    log_prior: float = 0.0


@dataclass(frozen=True)
class Tracker:
    """Says that 7 walks to the right, is lost for a while and is 9 then; and that 8 is there for a moment."""

    name: str = "a-tracker"

    ports = (Port(ObjectBoxes),)

    def smooth(
        self, incoming_over_time: Sequence[BatchIncoming], current: Nothing | None = None
    ) -> Smoothed[Nothing]:
        return Smoothed(Nothing())

    def messages(
        self, trajectory: Nothing, feature: ObjectBoxes, incoming_over_time: Sequence[BatchIncoming]
    ) -> list[BoxMessage]:
        said = []
        for frame in range(N_FRAMES):
            boxes = {}
            if not 40 <= frame < 60:
                boxes[7 if frame < 40 else 9] = [100 + 2 * frame, 150, 20, 50]
            if frame in (3, 4):
                boxes[8] = [200, 100, 12, 30]
            covariances = np.broadcast_to(np.eye(4), (len(boxes), 4, 4))
            message = GaussianMessage.from_moments(
                list(boxes), np.reshape([*boxes.values()], (-1, 4)), covariances
            )
            said.append(BoxMessage(message) if boxes else BoxMessage())
        return said


def test_one_walk_is_one_object_and_a_moment_is_none() -> None:
    trajectories = ObjectTrajectories()
    model = MultiChain().connect(Tracker(), BOXES).connect(trajectories, BOXES, feedback=False)
    frames = [Frame(np.zeros((300, 400), np.uint8), number / 25, number + 1) for number in range(N_FRAMES)]
    solution = CoordinateAscent(model, tolerance=None).run(frames)
    assert len(solution.rounds) == 1
    found = solution[trajectories]
    assert set(found.boxes.identities.tolist()) == {7}
    for frame in (0, 30, 50, 99):
        (track,) = found.at(frame)
        assert track.identity == 7
        np.testing.assert_allclose(track.box, [100 + 2 * frame - 10, 100, 20, 50], atol=0.5)
        np.testing.assert_allclose(track.velocity, (50, 0), atol=3)  # 25 frames a second
        assert track.seen == (frame != 50)
    hidden, shown = (np.linalg.det(found.at(frame)[0].position_covariance) for frame in (50, 30))
    assert hidden > 4 * shown > 0
    said = solution.messages(trajectories, BOXES)
    _, means, _ = said[50].objects.moments
    np.testing.assert_allclose(means, [[200, 150, 20, 50]], atol=0.5)
    assert found.at(N_FRAMES) == []
