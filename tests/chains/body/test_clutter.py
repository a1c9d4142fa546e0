"""Clutter: what was there before and stays, against Bayes' rule on one thing."""

import numpy as np
import pytest
from rsmcm.chains.body.flesh_state import BORN, FOUND, MOST_CLUTTER, SUREST, Clutter, ClutterMatch

PLACE = np.array([[100.0, 50.0]])
NOTHING = np.zeros((0, 2))
HERE = np.array([0])
NOBODY = np.full((1, 2, 2), np.nan)


def looked(clutter: Clutter, places: np.ndarray, parts: np.ndarray = NOBODY) -> Clutter:
    match = ClutterMatch.of(clutter, places, np.full(len(places), 9.0), np.full(len(places), 1e-5), 3.0)
    return match.updated(HERE, parts, 20.0)


def test_what_is_seen_again_is_surer_and_what_is_missed_goes() -> None:
    clutter = looked(Clutter.none(1), PLACE)
    assert clutter.chances[0] == pytest.approx(BORN)
    for _ in range(3):
        clutter = looked(clutter, PLACE)
    assert clutter.chances[0, 0] == pytest.approx(SUREST)
    missed = looked(clutter, NOTHING)
    expected = SUREST * (1 - FOUND) / (1 - SUREST * FOUND)
    assert missed.chances[0, 0] == pytest.approx(expected)
    for _ in range(5):
        missed = looked(missed, NOTHING)
    assert missed.chances[0, 0] < 0.01


def test_its_gain_is_the_ratio_of_densities() -> None:
    clutter = Clutter(PLACE[None], np.array([[16.0]]), np.array([[0.5]]))
    match = ClutterMatch.of(clutter, PLACE + np.array([3.0, 0.0]), np.array([9.0]), np.array([1e-5]), 5.0)
    spread = 16.0 + 9.0 + 25.0
    ratio = FOUND * 0.5 * np.exp(-0.5 * 9 / spread) / (2 * np.pi * spread) / 1e-5
    assert match.gains[0, 0] == pytest.approx(np.log(ratio))
    assert match.log_absent[0] == 0
    away = ClutterMatch.of(clutter, PLACE + np.array([300.0, 0.0]), np.array([9.0]), np.array([1e-5]), 5.0)
    assert away.pairs[0, 0] == -1
    assert away.log_absent[0] == pytest.approx(np.log(1 - 0.5 * FOUND))


def test_what_a_hand_covers_is_neither_missed_nor_born() -> None:
    clutter = Clutter(PLACE[None], np.array([[16.0]]), np.array([[0.5]]))
    over = np.array([[PLACE[0] + 5.0, [np.nan, np.nan]]])
    assert looked(clutter, NOTHING, over).chances[0, 0] == 0.5
    assert looked(Clutter.none(1), PLACE, over).chances.max(initial=0.0) == 0


def test_no_more_than_a_dozen_are_kept() -> None:
    random = np.random.default_rng(0)
    clutter = Clutter.none(1)
    for _ in range(20):
        clutter = looked(clutter.moved(0.04, 10.0), random.uniform(0, 600, (8, 2)))
        assert clutter.chances.shape[1] <= MOST_CLUTTER
