"""Measures of hands that are taken for each other."""

import numpy as np
import pytest
from rsmcm.apps.body.measures import exchanged_hands, longest_exchange

LEFT, RIGHT = (300.0, 100.0), (200.0, 120.0)


@pytest.mark.parametrize(
    ("hands", "said"),
    [
        ((LEFT, RIGHT), 0),
        ((RIGHT, LEFT), 1),
        (((210, 160), (290, 60)), 1),
        ((RIGHT, RIGHT), 0),  # off, and not exchanged
        ((LEFT, (500, 400)), 0),
        (((np.nan, np.nan), RIGHT), np.nan),
    ],
)
def test_each_is_nearer_to_the_other(hands: tuple[tuple[float, float], ...], said: float) -> None:
    np.testing.assert_array_equal(exchanged_hands(np.array([hands]), np.array([[LEFT, RIGHT]]), 50.0), [said])


def test_hands_together_tell_nothing() -> None:
    together = np.array([[(250.0, 100.0), (260.0, 100.0)]])
    assert np.isnan(exchanged_hands(together[:, ::-1], together, 50.0)).all()
    assert exchanged_hands(together[:, ::-1], together, 5.0) == [1]


def test_longest_stretch_bridges_what_cannot_be_told() -> None:
    nan = np.nan
    assert longest_exchange(np.arange(6), np.array([0, 1, 1, 0, 1, 0])) == 2
    assert longest_exchange(np.arange(6), np.array([0, 1, nan, 1, nan, 0])) == 3
    assert longest_exchange(np.array([1, 5, 9, 13]), np.array([1.0, 1, 1, 0])) == 9
    assert longest_exchange(np.arange(4), np.array([0, nan, nan, 0])) == 0
