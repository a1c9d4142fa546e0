import cv2
import numpy as np
import pytest
from rsmcm.apps.scenes.random_fields import mottle
from rsmcm.chains.points.feature_matcher import (
    LARGEST,
    LEAST_LIKENESS,
    LOCALISATION,
    Features,
    find_features,
    match_along_lines,
    match_features,
)

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


def test_the_nearest_neighbours_are_those_of_all_pairs() -> None:
    generator = np.random.default_rng(6)
    one, other = (unit(generator, count) for count in (40, 60))
    other.descriptors[:30] = np.clip(
        one.descriptors[:30].astype(int) + generator.integers(-3, 4, (30, 128)), 0, 255
    )
    pairs, doubt = match_features(one, other)
    a, b = (each.descriptors / 255 for each in (one, other))
    distance = np.sqrt(np.maximum(2 - 2 * a @ b.T, 0))
    expected = {}
    for i, row in enumerate(distance):
        j = int(row.argmin())
        column = distance[:, j]
        ratio = max(row[j] / np.partition(row, 1)[1], column[i] / np.partition(column, 1)[1])
        if column.argmin() == i and ratio < 0.8:
            expected[i, j] = ratio
    assert {tuple(pair) for pair in pairs.tolist()} == set(expected)
    np.testing.assert_allclose(doubt, list(expected.values()), atol=5e-3)
    assert len(pairs) >= 30


def unit(generator: np.random.Generator, count: int) -> Features:
    descriptors = np.abs(generator.normal(size=(count, 128)))
    descriptors *= 255 / np.linalg.norm(descriptors, axis=1, keepdims=True)
    return Features(np.zeros((count, 2)), np.ones(count), np.rint(descriptors).astype(np.uint8))


def test_features_are_each_at_a_place_of_its_own_and_the_clearest_stay() -> None:
    image = picture(7)
    every, some = find_features(image, 5000), find_features(image, 50)
    assert len(some) == 50
    np.testing.assert_array_equal(some.positions, every.positions[:50])
    rows = np.column_stack([every.positions, every.deviations])
    assert len(np.unique(rows, axis=0)) == len(rows)
    assert every.deviations.max() <= LOCALISATION * LARGEST
    lengths = np.linalg.norm(every.descriptors.astype(float), axis=1)
    np.testing.assert_allclose(lengths, 255, atol=4)


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
