"""Numbers of frames in words."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.view.page import listed, listed_periods, periods, rates


def test_lists() -> None:
    assert listed([3]) == "frame 3"
    assert listed([3, 4, 7]) == "frames 3, 4, 7"
    assert listed(range(1, 31)) == f"frames {', '.join(map(str, range(1, 21)))}, …"
    assert listed_periods([(5, 7)]) == "frames 5 to 7"
    assert listed_periods([(5, 7), (20, 20)]) == "frames 5 to 7, 20"
    assert listed_periods([(20, 20)]) == "frame 20"


@given(st.sets(st.integers(1, 60)), st.integers(1, 4))
def test_periods_hold_what_is_chosen(chosen: set[int], step: int) -> None:
    """And nothing else; between two of them there is a frame that is not chosen."""
    numbers = list(range(1, 61, step))
    found = periods(numbers, sorted(chosen))
    inside = [number for number in numbers if any(first <= number <= last for first, last in found)]
    assert inside == [number for number in numbers if number in chosen]
    for (_, last), (first, _) in pairwise(found):
        assert any(last < number < first for number in numbers)


def test_frames_that_took_no_time_have_no_rate() -> None:
    """As those have that are answered at the end of a film."""
    shown = rates([0.5] * 30 + [0.0] * 40)
    assert np.allclose(shown[:18], 2)
    assert np.isfinite(shown[:42]).all()
    assert np.isnan(shown[42:]).all()
