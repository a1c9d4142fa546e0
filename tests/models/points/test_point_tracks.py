"""Points as a feature node: messages, given points, and points found in pictures of exact motion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models import Frame, PointTracks
from rsmcm.models.core.frame import GivenPoints
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.points.patches import Patches, find_corners
from rsmcm.models.points.point_tracks import MAX_COORDINATE, PointMessage, View, check_points, noise_of_tracks
from scipy.stats import norm

from ...support.pictures import HEIGHT, WIDTH, Pose, film, hidden_by_a_bar


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((np.inf, 0.0), "finite px"),
        ((0.0, -1.01 * MAX_COORDINATE), "finite px"),
        ((np.nan, 1.0), "both coordinates or none"),
        ((1.0, np.nan), "both coordinates or none"),
    ],
)
def test_damaged_points_are_named(place: tuple[float, float], expected: str) -> None:
    points = np.zeros((3, 4, 2))
    points[0, 0], points[1, 1] = np.nan, MAX_COORDINATE
    check_points("some.npy", points)
    points[2, 3] = place
    if "both" in expected:
        check_points("some.npy", points, allow_single=True)
    else:
        with pytest.raises(ValueError, match=expected):
            check_points("some.npy", points, allow_single=True)
    with pytest.raises(ValueError, match=f"some.npy: got .* at point 3 of frame 2 .*, expected {expected}"):
        check_points("some.npy", points)


Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

STILL, SHIFT = Pose(np.eye(2), np.zeros(2)), np.array([3.4, -1.7])
MOVED = Pose(np.eye(2), SHIFT)
NODE = PointTracks()
PAIR = film([STILL, MOVED], noise=0.0)


def gaussians(identities: NDArray[np.int64] | list[int], means: Array, deviation: float) -> GaussianMessage:
    covariances = np.tile(deviation**2 * np.eye(2), (len(means), 1, 1))
    return GaussianMessage.from_moments(identities, means, covariances)


def view_of(grey: Grey, time: float = 0.0, found: Array | None = None) -> View:
    places = np.zeros((0, 2)) if found is None else found
    return View(time, GivenPoints(places, np.arange(len(places))), grey, 1.0, 5)


def prior_at(
    grey: Grey, points: Array, expected: Array, deviation: float, *, looks_back: bool = False
) -> PointMessage:
    """A tracker's message about points of a picture, which it expects elsewhere in the next."""
    numbers = np.arange(len(points))
    patches = Patches(numbers, view_of(grey).patches_at(points))
    return PointMessage(
        gaussians(numbers, expected, deviation), patches, view_of(grey, 0.0, points) if looks_back else None
    )


def frame(grey: Grey, number: int = 2) -> Frame:
    return Frame(grey, 0.04 * (number - 1), number)


# --- messages ---


@st.composite
def messages(draw: st.DrawFn) -> PointMessage:
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    identities = np.array(sorted(draw(st.sets(st.integers(0, 6), max_size=4))), np.int64)
    positions = gaussians(identities, random.normal(size=(len(identities), 2)), 1.0)
    view = view_of(np.zeros((5, 5), np.uint8), draw(st.integers(0, 5))) if draw(st.booleans()) else None
    same = None
    if draw(st.booleans()):
        same = np.minimum(identities, random.integers(0, 7, len(identities)))
    return PointMessage(positions, None, view, same)


def same(one: PointMessage, other: PointMessage) -> None:
    np.testing.assert_array_equal(one.positions.identities, other.positions.identities)
    np.testing.assert_allclose(one.positions.information, other.positions.information)
    np.testing.assert_allclose(one.positions.vector, other.positions.vector, atol=1e-12)
    assert one.log_mass == pytest.approx(other.log_mass)
    assert (one.view and one.view.time) == (other.view and other.view.time)
    if one.same_as is None or other.same_as is None:
        assert one.same_as is other.same_as
    else:
        np.testing.assert_array_equal(one.same_as, other.same_as)


@given(messages(), messages(), messages())
def test_products_are_commutative_and_associative_and_uniform_is_neutral(
    one: PointMessage, two: PointMessage, three: PointMessage
) -> None:
    same(one * two, two * one)
    same((one * two) * three, one * (two * three))
    same(one * NODE.uniform(), one)
    same(NODE.uniform() * one, one)


def test_appearance_is_one_trackers() -> None:
    message = prior_at(np.zeros((50, 50), np.uint8), np.array([[20.0, 20.0]]), np.array([[20.0, 20.0]]), 1.0)
    assert (message * NODE.uniform()).patches is message.patches
    assert (NODE.uniform() * message).patches is message.patches
    with pytest.raises(ValueError, match="from two chains"):
        message * message


# --- points that are given ---


def test_given_points_are_evidence_whatever_the_prior() -> None:
    points = GivenPoints(np.array([[3.0, 4.0], [10.0, 20.0]]), np.array([2, 7]))
    node = PointTracks(noise=0.3)
    for prior in (node.uniform(), PointMessage(gaussians([2], np.array([[99.0, 99.0]]), 0.1))):
        seen = node.evidence(Frame(None, 0.0, 1, points), prior)
        identities, mean, covariance = seen.positions.moments
        np.testing.assert_array_equal(identities, [2, 7])
        np.testing.assert_allclose(mean, points.positions)
        np.testing.assert_allclose(covariance, np.tile(0.09 * np.eye(2), (2, 1, 1)))
        assert seen.log_mass == pytest.approx(0)  # a density
        assert seen.view is not None
        assert seen.view.points is points


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e4])
def test_noise_of_tracks_is_found_in_any_unit_and_in_spite_of_jumps(scale: float) -> None:
    random = np.random.default_rng(0)
    angles = random.uniform(0, 6, 30) + 0.1 * np.arange(50)[:, None]
    tracks = np.stack([np.cos(angles), np.sin(angles)], axis=2) * 50 + random.normal(0, 0.4, (50, 30, 2))
    tracks[25:, :6] += 20
    frames = [
        Frame(None, 0.04 * t, t + 1, GivenPoints(scale * points, np.arange(30)))
        for t, points in enumerate(tracks)
    ]
    assert noise_of_tracks(frames) == pytest.approx(0.4 * scale, rel=0.1)
    few = [replace(each, points=None) if t % 3 == 0 else each for t, each in enumerate(frames)]
    assert 0 < noise_of_tracks(few) < 10 * scale  # no track of four frames: a guess
    with pytest.raises(ValueError, match="got none"):
        noise_of_tracks([Frame(None, 0.0, 1)])
    for each in frames[::2]:
        assert each.points is not None
        each.points.positions[::3, 0] = np.nan
    assert noise_of_tracks(frames) == pytest.approx(0.4 * scale, rel=0.1)


def test_one_known_coordinate_says_nothing_of_the_other() -> None:
    node = PointTracks(noise=0.5)
    given = GivenPoints(np.array([[1.0, 2.0], [np.nan, 4.0]]), np.array([3, 7]))
    said = node.evidence(Frame(None, 0.0, 1, given), node.uniform()).positions
    # the integral of its product with any density is that density's value at the line
    other = GaussianMessage.from_moments([3, 7], [[1.5, 2.5], [9.0, 3.0]], [np.eye(2), 4 * np.eye(2)])
    expected = norm.logpdf([1.0, 2.0], [1.5, 2.5], np.sqrt(1.25)).sum() + norm.logpdf(4, 3, np.sqrt(4.25))
    product = said * other
    assert product.log_mass == pytest.approx(expected)
    np.testing.assert_allclose(product.marginal(7)[0], [9.0, 3 + 4 / 4.25])
    np.testing.assert_array_equal(said.moments[0], [3])
    assert said.log_mass == pytest.approx(0)  # a density of what is known


# --- pictures ---


def test_points_are_found_where_they_are() -> None:
    errors, distances = [], []
    for seed in range(3):
        before, after = film([STILL, MOVED], seed, noise=2.0)
        points = find_corners(before, 100, np.zeros((0, 2)), 8, 5)
        points = points[((points > 10) & (points < [WIDTH - 10, HEIGHT - 10])).all(axis=1)]
        seen = NODE.evidence(frame(after), prior_at(before, points, points, 2.5, looks_back=True))
        identities, mean, covariance = seen.positions.moments
        assert len(identities) > 0.8 * len(points)
        off = mean - points[identities] - SHIFT
        errors.append(off)
        distances.append((off * np.linalg.solve(covariance, off[:, :, None])[:, :, 0]).sum(axis=1))
    off, squares = np.concatenate(errors), np.concatenate(distances)
    right = np.abs(off).max(axis=1) < 1
    assert right.mean() > 0.98
    assert np.sqrt((off[right] ** 2).mean()) < 0.2
    # stated covariances: half of the errors would be inside exactly
    assert 0.4 < (squares[right] < 2 * np.log(2)).mean() < 0.9
    assert (squares[right] < 13.8).mean() > 0.95  # all but one in a thousand, if they were exact


def test_a_find_counts_as_against_being_anywhere() -> None:
    before, after = film([STILL, MOVED])
    points = find_corners(before, 20, np.zeros((0, 2)), 8, 5)
    seen = NODE.evidence(frame(after), prior_at(before, points, points + SHIFT, 0.5))
    assert len(seen.positions) > 10
    assert seen.log_mass == pytest.approx(len(seen.positions) * np.log(after.size))


def test_what_is_hidden_is_no_information() -> None:
    found_behind, found_free = [], []
    for seed in range(5):
        before, after = film([STILL, MOVED], seed)
        (_, hidden) = hidden_by_a_bar([before, after], -20, 4.0, 60)  # columns 24 to 84
        points = find_corners(before, 100, np.zeros((0, 2)), 8, 5)
        behind = (points[:, 0] > 30) & (points[:, 0] < 70)
        seen = NODE.evidence(frame(hidden), prior_at(before, points, points + SHIFT, 1.0, looks_back=True))
        found = np.isin(np.arange(len(points)), seen.positions.identities)
        free = (points[:, 0] < 15) | (points[:, 0] > 90)
        found_behind.append(found[behind])
        found_free.append(found[free])
    assert np.concatenate(found_behind).size > 60
    assert (
        np.concatenate(found_behind).mean() < 0.3
    )  # chance matches: a tenth of some 120, by a standard error of 0.03
    assert np.concatenate(found_free).mean() > 0.8
