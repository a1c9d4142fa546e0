"""Features, their matches in a film of a turntable, and the chain of matched points."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from rsmcm.apps.scenes import turntable
from rsmcm.apps.scenes.random_fields import mottle
from rsmcm.chains import FeatureMatcher
from rsmcm.chains.points.feature_matcher import (
    FIRST_IDENTITY,
    LEAST_LENGTH,
    LEAST_LIKENESS,
    Features,
    FilmMatches,
    find_features,
    join_matches,
    match_along_lines,
    match_features,
)
from rsmcm.inference import CoordinateAscent, MultiChain
from rsmcm.inference.engine.protocols import Cavity, Port, Smoothed
from rsmcm.models.core.frame import Frame
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.points.point_tracks import PointMessage, PointTracks

from ...support.scenes import transferred

SIZE = 300, 400


def picture(seed: int) -> np.ndarray:
    field = mottle(SIZE, 60.0, 1.5, np.random.default_rng(seed))
    return np.clip(128 + 40 * field, 0, 255).astype(np.uint8)


def warped(image: np.ndarray, transform: np.ndarray, seed: int) -> np.ndarray:
    """As a camera would see a plane: another place, size and light, and noise."""
    seen = cv2.warpPerspective(image, transform, SIZE[::-1], flags=cv2.INTER_CUBIC).astype(np.float64)
    seen = 0.7 * seen + 30 + np.random.default_rng(seed).normal(0, 2, SIZE)
    return np.clip(seen, 0, 255).astype(np.uint8)


def rotation(degrees: float, scale: float) -> np.ndarray:
    return np.vstack([cv2.getRotationMatrix2D((200, 150), degrees, scale), [3e-5, -2e-5, 1]])


@pytest.mark.parametrize(("degrees", "scale"), [(5, 1.0), (40, 1.0), (170, 0.8), (-20, 1.25)])
def test_a_plane_is_recognised_wherever_it_is(degrees: float, scale: float) -> None:
    image, transform = picture(0), rotation(degrees, scale)
    one, other = find_features(image, 2000), find_features(warped(image, transform, 1), 2000)
    pairs, _ = match_features(one, other)
    true = cv2.perspectiveTransform(one.positions[pairs[:, 0], None], transform)[:, 0]
    off = other.positions[pairs[:, 1]] - true
    right = np.linalg.norm(off, axis=1) < 3
    assert len(pairs) > 150
    assert right.mean() > 0.97
    assert np.median(np.linalg.norm(off[right], axis=1)) < 0.3


def test_a_plane_is_recognised_when_it_is_tilted() -> None:
    """By 63 degrees: affine features still match where plain ones hardly do."""
    image = picture(4)
    transform = np.array([[0.45, 0, 110], [0, 1, 0], [0, 0, 1.0]])
    tilted = warped(image, transform, 5)
    right = []
    for affine in (False, True):
        one, other = (find_features(each, 4000, affine=affine) for each in (image, tilted))
        pairs, _ = match_features(one, other)
        true = cv2.perspectiveTransform(one.positions[pairs[:, 0], None], transform)[:, 0]
        off = np.linalg.norm(other.positions[pairs[:, 1]] - true, axis=1)
        right.append(np.count_nonzero(off < 3))
    assert right[1] > 100 + 3 * right[0]
    assert np.mean(off < 3) > 0.9
    assert np.median(off[off < 3]) < 0.7
    assert len(one.place) > len(one)
    np.testing.assert_array_equal(np.unique(one.place), np.arange(len(one)))


def test_places_have_no_bias_and_are_as_near_as_they_say() -> None:
    image, transform = picture(2), rotation(170, 1.0)  # where a shift that both pictures share is doubled
    one, other = find_features(image, 2000), find_features(warped(image, transform, 3), 2000)
    pairs, _ = match_features(one, other)
    true = cv2.perspectiveTransform(one.positions[pairs[:, 0], None], transform)[:, 0]
    off = other.positions[pairs[:, 1]] - true
    right = np.linalg.norm(off, axis=1) < 3
    assert np.abs(off[right].mean(axis=0)).max() < 0.03
    stated = np.hypot(one.deviations[pairs[:, 0]], other.deviations[pairs[:, 1]])[right, None]
    # a plane is easier than a body, whose surface turns away
    assert 0.1 < np.sqrt(np.mean((off[right] / stated) ** 2)) < 0.7


@pytest.mark.parametrize("several", [1, 3])
def test_the_nearest_neighbours_are_those_of_all_pairs(several: int) -> None:
    """Of two features with so many descriptors each, in no order, the two most similar ones count."""
    generator = np.random.default_rng(6)
    one, other = (unit(generator, count, several) for count in (40, 60))
    other.descriptors[:30] = np.clip(
        one.descriptors[:30].astype(int) + generator.integers(-3, 4, (30, 128)), 0, 255
    )
    other.place[:30] = one.place[:30]
    pairs, doubt = match_features(one, other)
    a, b = (each.descriptors / 255 for each in (one, other))
    distance = np.full((40, 60), np.inf)
    np.minimum.at(distance, (one.place[:, None], other.place), np.sqrt(np.maximum(2 - 2 * a @ b.T, 0)))
    expected = {}
    for i, row in enumerate(distance):
        j = int(row.argmin())
        column = distance[:, j]
        ratio = max(row[j] / np.partition(row, 1)[1], column[i] / np.partition(column, 1)[1])
        if column.argmin() == i and ratio < 0.8:
            expected[i, j] = ratio
    assert {tuple(pair) for pair in pairs.tolist()} == set(expected)
    np.testing.assert_allclose(doubt, list(expected.values()), atol=5e-3)
    assert len(pairs) >= 15


def unit(generator: np.random.Generator, count: int, several: int) -> Features:
    descriptors = np.abs(generator.normal(size=(several * count, 128)))
    descriptors *= 255 / np.linalg.norm(descriptors, axis=1, keepdims=True)
    place = generator.permutation(np.repeat(np.arange(count), several))
    return Features(np.zeros((count, 2)), np.ones(count), np.rint(descriptors).astype(np.uint8), place)


def test_repeated_things_are_told_apart_by_where_they_must_be() -> None:
    """Tiles that are all the same but for their noise, and some that are not: a camera moves to the right."""
    generator = np.random.default_rng(9)
    tiles = np.tile(picture(9)[:60, :80].astype(float), (5, 5))
    tiles[:, 160:240] = picture(10)[:, 160:240]
    shift = np.array([12.0, 0.0])
    views = [
        np.clip(cv2.warpAffine(tiles, np.array([[1, 0, x], [0, 1, 0.0]]), SIZE[::-1]) + noise, 0, 255)
        for x, noise in zip((0.0, shift[0]), generator.normal(0, 3, (2, *SIZE)), strict=True)
    ]
    one, other = (find_features(view.astype(np.uint8), 2000) for view in views)
    sideways = np.array([[0, 0, 0], [0, 0, -1], [0, 1, 0.0]])  # epipolar lines are rows
    pairs, _ = match_features(one, other)
    motion = other.positions[pairs[:, 1]] - one.positions[pairs[:, 0]]
    known = pairs[np.linalg.norm(motion - shift, axis=1) < 1]
    assert len(known) > 30
    again, doubt = match_along_lines(one, other, known, sideways, 1.5)
    motion = other.positions[again[:, 1]] - one.positions[again[:, 0]]
    assert len(again) > 1.5 * len(known)
    assert np.mean(np.linalg.norm(motion - shift, axis=1) < 2) > 0.97
    assert np.abs(motion[:, 1]).max() <= 1.5
    likeness = (one.descriptors[again[:, 0]].astype(float) * other.descriptors[again[:, 1]]).sum(axis=1)
    assert likeness.min() >= LEAST_LIKENESS * 255**2 - 1
    assert doubt.max() < 0.8


FILM = turntable(8, (288, 360), 5.0, seed=1)
PICTURES = [find_features(image, 1000) for image in FILM.images]
MATCHES = FilmMatches.of(PICTURES)
POSITIONS = np.concatenate([each.positions for each in PICTURES])


def off(one: np.ndarray, other: np.ndarray, matches: FilmMatches = MATCHES) -> np.ndarray:
    """px by which features are off from where the geometry has what the first ones show."""
    frames = np.stack([matches.frame[one], matches.frame[other]], axis=1)
    distance = np.full(len(one), np.inf)
    for pair in np.unique(frames, axis=0):
        here = (frames == pair).all(axis=1)
        there = transferred(FILM, POSITIONS[one[here]], *pair.tolist())
        distance[here] = np.linalg.norm(there - POSITIONS[other[here]], axis=1)
    return distance


def test_matches_are_right() -> None:
    distance = off(*MATCHES.pairs.T)
    assert np.isfinite(distance).mean() > 0.9
    distance = distance[np.isfinite(distance)]  # at the rim it is not known what a feature shows
    assert len(distance) > 1000
    assert np.mean(distance < 3) > 0.99
    assert np.median(distance) < 0.4
    steps = MATCHES.frame[MATCHES.pairs[:, 1]] - MATCHES.frame[MATCHES.pairs[:, 0]]
    assert set(np.unique(steps).tolist()) >= {1, 2, 3}


def test_tracks_show_one_point_and_never_twice_in_a_picture() -> None:
    features, track = MATCHES.tracks(10**6)
    assert len(np.unique(features)) == len(features)
    places = np.stack([track, MATCHES.frame[features]], axis=1)
    assert len(np.unique(places, axis=0)) == len(places)
    assert np.bincount(track).min() >= LEAST_LENGTH
    order = np.lexsort((MATCHES.frame[features], track))
    one, other = features[order[:-1]], features[order[1:]]
    same = track[order[:-1]] == track[order[1:]]
    distance = off(one[same], other[same])
    assert np.mean(distance[np.isfinite(distance)] < 3) > 0.99
    assert len(np.unique(track)) > 200


def test_of_a_picture_the_longest_tracks_stay() -> None:
    features, every = MATCHES.tracks(10**6)
    length = np.bincount(every)[every]
    kept, some = MATCHES.tracks(40)
    assert len(np.unique(some)) < len(np.unique(every))
    for picture in range(len(PICTURES)):
        here = MATCHES.frame[features] == picture
        stay = np.isin(features[here], kept)
        assert stay.sum() >= min(40, here.sum())
        shortest = np.sort(length[here])[::-1][:40].min()
        assert stay[length[here] > shortest].all()


def groups(features: np.ndarray, track: np.ndarray) -> set[frozenset[int]]:
    return {frozenset(features[track == each].tolist()) for each in np.unique(track)}


def test_joining_agrees_with_sets() -> None:
    generator = np.random.default_rng(1)
    frame = np.repeat(np.arange(6), 8)
    matches = generator.integers(0, 48, (150, 2))
    track = join_matches(matches, frame, 6)
    sets = {number: {number} for number in range(48)}
    for one, other in matches.tolist():
        a, b = sets[one], sets[other]
        if a is not b and not {frame[each] for each in a} & {frame[each] for each in b}:
            for each in b:
                sets[each] = a
            a |= b
    expected = {frozenset(each) for each in sets.values()}
    assert groups(np.arange(48), track) == expected
    assert max(map(len, expected)) > 3


def test_similar_pictures_are_matched_whenever_they_were_taken() -> None:
    order = [0, 1, 2, 3, 4, 5, 6, 7, 0, 1]
    found = FilmMatches.of([PICTURES[number] for number in order])
    seen = np.array(order)[found.frame[found.pairs]]
    assert len(found.pairs) > 0.5 * len(MATCHES.pairs)
    for first, second in zip(range(7), range(1, 8), strict=True):
        assert ((np.sort(seen, axis=1) == [first, second]).all(axis=1)).sum() > 30
    again = np.sort(found.frame[found.pairs], axis=1)
    assert ((again == [0, 8]).all(axis=1)).sum() > 100


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
    assert len(seen.frame) > 1.08 * len(matched.frame)
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
    names, messages = tracks.identities[tracks.matched.point], last.messages("geometry", POINTS)
    said = [
        name in messages[frame].positions.identities
        for frame, name in zip(tracks.matched.frame, names, strict=True)
    ]
    before = np.isin(names, list(wrong)) & said  # at the rim nothing is said of them
    kept = np.isin(
        tracks.matched.frame * 1000 + tracks.matched.point, tracks.seen.frame * 1000 + tracks.seen.point
    )
    assert before.sum() >= 30
    assert kept[before].mean() < 0.05  # one in 450 is, by chance: two of sixty at most
    assert kept[~np.isin(names, list(wrong))].mean() > 0.97
