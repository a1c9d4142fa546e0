import numpy as np
import pytest
from rsmcm.apps.scenes import turntable
from rsmcm.chains.points.feature_matcher import (
    LEAST_LENGTH,
    FilmMatches,
    find_features,
    join_matches,
)

from ...support.scenes import transferred

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


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4, 5, 6, 7, 0, 1], [0, 4, 1, 5, 2, 6, 3, 7]])
def test_pictures_that_are_alike_are_matched_whenever_they_were_taken(order: list[int]) -> None:
    found = FilmMatches.of([PICTURES[number] for number in order])
    seen = np.array(order)[found.frame[found.pairs]]
    assert len(found.pairs) > 0.5 * len(MATCHES.pairs)
    for first, second in zip(range(7), range(1, 8), strict=True):
        assert ((np.sort(seen, axis=1) == [first, second]).all(axis=1)).sum() > 30
    if len(order) == 10:
        again = np.sort(found.frame[found.pairs], axis=1)
        assert ((again == [0, 8]).all(axis=1)).sum() > 100
