"""State of the flesh tracker: clutter against Bayes' rule, and the prior of lost parts."""

import numpy as np
import pytest
from rsmcm.chains import FleshTracker
from rsmcm.chains.body.flesh_assignment import MovingParts
from rsmcm.chains.body.flesh_state import (
    BIRTH,
    DETECTED,
    HANDS,
    MOST_CLUTTER,
    MOST_EXISTENCE,
    Clutter,
    ClutterMatch,
    FleshTracks,
    within_reach,
)
from rsmcm.models.body.upper_body import UpperBody
from rsmcm.models.core.frame import Frame

PLACE = np.array([[100.0, 50.0]])
NOTHING = np.zeros((0, 2))
HERE = np.array([0])
NOBODY = np.full((1, 2, 2), np.nan)


def looked(clutter: Clutter, places: np.ndarray, parts: np.ndarray = NOBODY) -> Clutter:
    match = ClutterMatch.of(clutter, places, np.full(len(places), 9.0), np.full(len(places), 1e-5), 3.0)
    return match.updated(HERE, parts, 20.0)


def test_what_is_seen_again_is_surer_and_what_is_missed_goes() -> None:
    clutter = looked(Clutter.none(1), PLACE)
    assert clutter.existence[0] == pytest.approx(BIRTH)
    for _ in range(3):
        clutter = looked(clutter, PLACE)
    assert clutter.existence[0, 0] == pytest.approx(MOST_EXISTENCE)
    missed = looked(clutter, NOTHING)
    expected = MOST_EXISTENCE * (1 - DETECTED) / (1 - MOST_EXISTENCE * DETECTED)
    assert missed.existence[0, 0] == pytest.approx(expected)
    for _ in range(5):
        missed = looked(missed, NOTHING)
    assert missed.existence[0, 0] < 0.01


def test_its_gain_is_the_ratio_of_densities() -> None:
    clutter = Clutter(PLACE[None], np.array([[16.0]]), np.array([[0.5]]))
    match = ClutterMatch.of(clutter, PLACE + np.array([3.0, 0.0]), np.array([9.0]), np.array([1e-5]), 5.0)
    spread = 16.0 + 9.0 + 25.0
    ratio = DETECTED * 0.5 * np.exp(-0.5 * 9 / spread) / (2 * np.pi * spread) / 1e-5
    assert match.gains[0, 0] == pytest.approx(np.log(ratio))
    assert match.log_absent[0] == 0
    away = ClutterMatch.of(clutter, PLACE + np.array([300.0, 0.0]), np.array([9.0]), np.array([1e-5]), 5.0)
    assert away.pairs[0, 0] == -1
    assert away.log_absent[0] == pytest.approx(np.log(1 - 0.5 * DETECTED))


def test_what_a_hand_covers_is_neither_missed_nor_born() -> None:
    clutter = Clutter(PLACE[None], np.array([[16.0]]), np.array([[0.5]]))
    over = np.array([[PLACE[0] + 5.0, [np.nan, np.nan]]])
    assert looked(clutter, NOTHING, over).existence[0, 0] == 0.5
    assert looked(Clutter.none(1), PLACE, over).existence.max(initial=0.0) == 0


def test_no_more_than_a_dozen_are_kept() -> None:
    random = np.random.default_rng(0)
    clutter = Clutter.none(1)
    for _ in range(20):
        clutter = looked(clutter.predict(0.04, 10.0), random.uniform(0, 600, (8, 2)))
        assert clutter.existence.shape[1] <= MOST_CLUTTER


# --- lost parts ---

BODY = UpperBody.from_head(90.0)


def nothing_known() -> FleshTracks:
    return FleshTracker(BODY).initial(Frame(np.zeros((360, 640, 3), np.uint8), 0.0, 1))


def test_a_part_that_is_less_certain_than_a_lost_one_is_replaced_by_it() -> None:
    tracks = nothing_known()
    lost = MovingParts(tracks.means.copy(), tracks.covariances.copy())
    tracks.means[0, :, :2] = [[300.0, 90.0], [380.0, 200.0], [900.0, -50.0]]
    for part, std in enumerate((5.0, 12.0, 2000.0)):
        tracks.covariances[0, part] = std**2 * np.eye(4)
    after = within_reach(tracks, lost)
    for part, expected in enumerate((tracks, tracks, lost)):
        np.testing.assert_array_equal(after.means[0, part], expected.means[0, part])
        np.testing.assert_array_equal(after.covariances[0, part], expected.covariances[0, part])


def test_prior_of_lost_parts() -> None:
    """A head anywhere in the image; hands below it, the person's own left one on the right."""
    tracks = nothing_known()
    head, left, right = tracks.positions
    np.testing.assert_allclose(head, (320.0, 180.0))
    np.testing.assert_allclose(left - right, (BODY.shoulder_width, 0.0))
    reach = BODY.upper_arm + BODY.forearm
    np.testing.assert_allclose(0.5 * (left + right), head + np.array([0.0, BODY.neck + 0.25 * reach]))
    np.testing.assert_allclose(tracks.position_covariances[0], np.diag([640.0**2, 360.0**2]) / 12)
    for hand in HANDS:
        expected = tracks.position_covariances[0] + 0.25 * reach**2 * np.eye(2)
        np.testing.assert_allclose(tracks.position_covariances[hand], expected)
    assert not tracks.trust.any()
    tracks.since[0] = (0.0, tracks.max_coast_time, 2 * tracks.max_coast_time)
    np.testing.assert_allclose(tracks.trust, np.exp([[0.0, -1.0, -2.0]]))
