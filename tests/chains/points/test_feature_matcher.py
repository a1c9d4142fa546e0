from dataclasses import dataclass, replace

import numpy as np
import pytest
from rsmcm.apps.scenes import turntable
from rsmcm.chains import FactorStructure, FeatureMatcher, PointTracker
from rsmcm.chains.points.feature_matcher import FIRST_IDENTITY
from rsmcm.inference import CoordinateAscent, MultiChain
from rsmcm.inference.engine.protocols import Cavity, Port, Smoothed
from rsmcm.inference.sfm.affine_camera import euclidean
from rsmcm.models.core.frame import Frame, GivenPoints
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.points.point_tracks import PointMessage, PointTracks

from ...support.scenes import transferred

FILM = turntable(8, (288, 360), 5.0, seed=1)
POINTS, MATCHER = PointTracks(), FeatureMatcher(n_points=100, n_features=1000)


def alone(frames: list[Frame]):
    return CoordinateAscent(MultiChain().connect(MATCHER, POINTS)).run(frames)


def test_points_are_seen_where_they_are() -> None:
    solution = alone(FILM.frames())
    before = None
    errors = []
    for number, message in enumerate(solution.evidence(POINTS)):
        names, mean, covariance = message.positions.moments
        assert len(names) > 50
        assert names.min() >= FIRST_IDENTITY
        # as against being anywhere in the picture
        np.testing.assert_allclose(message.log_mass, len(names) * np.log(288 * 360))
        if before is not None:
            _, here, there = np.intersect1d(before[0], names, return_indices=True)
            off = transferred(FILM, before[1][here], number - 1, number) - mean[there]
            errors.extend(np.linalg.norm(off, axis=1) / np.sqrt(covariance[there, 0, 0]))
        before = names, mean
    assert len(errors) > 300
    known = np.isfinite(errors)  # at the rim it is not known what a feature shows
    assert known.mean() > 0.9
    assert np.mean(np.array(errors)[known] < 12) > 0.99
    assert np.median(np.array(errors)[known]) < 2.5
    assert solution.converged
    assert solution.objective == pytest.approx(0, abs=1e-6)


def test_points_that_are_given_stay_as_they_are() -> None:
    given = GivenPoints(np.arange(12.0).reshape(6, 2), np.arange(6))
    frames = [replace(frame, points=given) for frame in FILM.frames()]
    for message in alone(frames).evidence(POINTS):
        names, mean, _ = message.positions.moments
        np.testing.assert_array_equal(names, given.identities)
        np.testing.assert_allclose(mean, given.positions)


@pytest.fixture(scope="module")
def side_by_side():
    model = MultiChain().connect(PointTracker(n_points=50), POINTS, feedback=False)
    model.connect(MATCHER, POINTS, feedback=False)
    model.connect(FactorStructure(coherence=False, associate=False), POINTS, feedback=False)
    return CoordinateAscent(model)


def test_tracker_and_matcher_share_the_points(side_by_side) -> None:
    solution = side_by_side.run(FILM.frames())
    matched = [message.positions for message in alone(FILM.frames()).evidence(POINTS)]
    followed = 0
    for both, features in zip(solution.evidence(POINTS), matched, strict=True):
        names = both.positions.identities
        np.testing.assert_array_equal(names[names >= FIRST_IDENTITY], features.identities)
        followed += int((names < FIRST_IDENTITY).sum())
    assert followed > 50
    known = solution["structure"].identities
    assert np.isin(solution["matcher"].identities, known).all()
    assert solution.converged
    assert len(solution.rounds) == 1


@dataclass(frozen=True)
class GeometryKnown:
    """A chain that knows where every point is in every frame, but for some that it has wrong."""

    wrong: frozenset[int] = frozenset()
    name: str = "geometry"

    ports = (Port(PointTracks, Cavity.OTHERS),)

    def smooth(self, incoming_over_time, current=None) -> Smoothed["Places"]:
        if current is not None:
            return Smoothed(current)
        seen = [incoming[PointTracks].positions.moments for incoming in incoming_over_time]
        places = []
        for frame in range(len(seen)):
            here: dict[int, np.ndarray] = {}
            for other in sorted(range(len(seen)), key=lambda other: -abs(other - frame)):
                there = transferred(FILM, seen[other][1], other, frame)
                here |= dict(zip(seen[other][0].tolist(), there, strict=True))  # from the nearest one
            known = {name: place for name, place in here.items() if np.isfinite(place).all()}
            moved = [place + 30 * (name in self.wrong) for name, place in known.items()]
            places.append((np.array(list(known)), np.array(moved)))
        return Smoothed(Places(places))

    def messages(self, trajectory, feature: PointTracks, incoming_over_time=()) -> list[PointMessage]:
        spread = np.eye(2)
        return [
            PointMessage(GaussianMessage.from_moments(names, places, np.tile(spread, (len(names), 1, 1))))
            for names, places in trajectory.places
        ]


@dataclass(frozen=True, eq=False)
class Places:
    places: list[tuple[np.ndarray, np.ndarray]]
    log_prior: float = 0.0


def test_points_are_searched_for_where_others_expect_them() -> None:
    frames = FILM.frames()
    model = MultiChain().connect(MATCHER, POINTS, feedback=False).connect(GeometryKnown(), POINTS)
    first, second = CoordinateAscent(model, 2, tolerance=None).rounds(frames)
    matched, seen = (solution["matcher"].seen for solution in (first, second))
    assert len(seen.frame) > 1.2 * len(matched.frame)
    best = CoordinateAscent(model, 2).run(frames)
    assert len(best["matcher"].seen.frame) == len(seen.frame)  # what is found speaks for itself
    places = np.stack([seen.frame, seen.point], axis=1)
    assert len(np.unique(places, axis=0)) == len(places)
    off = np.full(len(places), np.inf)
    for number, (frame, point, place) in enumerate(zip(seen.frame, seen.point, seen.positions, strict=True)):
        nearest = min(np.flatnonzero(matched.point == point), key=lambda k: abs(matched.frame[k] - frame))
        there = transferred(FILM, matched.positions[[nearest]], int(matched.frame[nearest]), int(frame))
        off[number] = np.linalg.norm(there - place)
    found = ~np.isin(places @ [1000, 1], np.stack([matched.frame, matched.point], axis=1) @ [1000, 1])
    assert np.mean(off[found & np.isfinite(off)] < 1.5) > 0.95
    assert np.median(off[found & np.isfinite(off)]) < 0.5


def test_matches_that_others_contradict_do_not_count() -> None:
    wrong = frozenset(range(FIRST_IDENTITY, FIRST_IDENTITY + 10))
    model = MultiChain().connect(MATCHER, POINTS, feedback=False).connect(GeometryKnown(wrong), POINTS)
    *_, last = CoordinateAscent(model, 2, tolerance=None).rounds(FILM.frames())
    tracks = last["matcher"]
    before = np.isin(tracks.identities[tracks.matched.point], list(wrong))
    kept = np.isin(
        tracks.matched.frame * 1000 + tracks.matched.point, tracks.seen.frame * 1000 + tracks.seen.point
    )
    assert before.sum() >= 30
    assert kept[before].mean() < 0.1  # at the rim nothing is said of them
    assert kept[~before].mean() > 0.97


@pytest.mark.slow
def test_a_turntable_at_ten_degrees_a_picture() -> None:
    film = turntable()
    matcher, shape = FeatureMatcher(), FactorStructure(coherence=False, associate=False)
    model = MultiChain().connect(matcher, POINTS, feedback=False).connect(shape, POINTS)
    *_, last = CoordinateAscent(model, 2).rounds(film.frames())
    assert len(last[matcher].identities) > 2000
    fit = last[shape].factorisation
    rotations = euclidean(fit.cameras, fit.shape, fit.camera_covariance).rotations
    turns = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
    degrees = np.degrees(np.arccos((np.trace(turns, axis1=1, axis2=2) - 1) / 2))
    # an affine camera before a body that is 16 radii away
    assert abs(np.median(degrees) - 10) < 0.7
    assert 9 < degrees.min() < degrees.max() < 11.2
