"""When an object is doubted, lost, on trial and believed again."""

import numpy as np
import pytest
from rsmcm.chains.face.recovery import (
    CHANCE,
    CHANCE_ANYWHERE,
    LEAST_SHARE,
    MAX_DOUBT_TIME,
    MEMORY,
    SHORTEST_TRIAL,
    TRIAL,
    Trust,
)


def test_usual_fit_is_that_of_the_last_second() -> None:
    trust = Trust()
    for _ in range(10):
        trust = trust.confirmed(0.4, MEMORY / 10)
    assert trust.usual_fit == pytest.approx(0.4 + 0.6 * np.exp(-1))
    half = Trust().confirmed(0.4, 0.3).confirmed(0.4, 0.7)
    assert half.usual_fit == pytest.approx(trust.usual_fit), "it is the same at any rate"
    assert trust.doubted(0.04).usual_fit == trust.usual_fit, "what is doubted is not usual"


def test_what_is_too_little_depends_on_what_is_usual() -> None:
    assert Trust(usual_fit=0.9).least_fit == pytest.approx(0.9 * LEAST_SHARE)
    assert Trust(usual_fit=0.6).least_fit < Trust(usual_fit=0.9).least_fit
    assert Trust(usual_fit=0.1).least_fit == CHANCE
    assert Trust(usual_fit=0.1).return_fit == CHANCE_ANYWHERE
    assert Trust(usual_fit=0.9).return_fit > Trust(usual_fit=0.9).least_fit


@pytest.mark.parametrize(("dt", "pictures"), [(0.04, 3), (1 / 30, 3), (0.2, 2), (10.0, 2)])
def test_lost_after_some_doubt(dt: float, pictures: int) -> None:
    trust = Trust()
    for _ in range(pictures - 1):
        trust = trust.doubted(dt)
        assert not trust.lost
    assert trust.doubted(dt).lost
    assert not trust.doubted(dt).confirmed(0.8, dt).lost


def test_a_trial() -> None:
    """It stays lost until the object was there for long enough; less long if its texture says so, too."""
    lost = Trust(usual_fit=0.8, doubt=2 * MAX_DOUBT_TIME, searches=3)
    for matches, seconds in ((True, SHORTEST_TRIAL), (False, TRIAL)):
        trust, pictures = lost.start_trial(matches=matches), 0
        while trust.trial:
            assert trust.lost
            trust, pictures = trust.continue_trial(0.9, 0.02), pictures + 1
        assert pictures == round(seconds / 0.02)
        assert (trust.lost, trust.relocations, trust.searches, trust.usual_fit) == (False, 1, 0, 0.9)
    failed = lost.start_trial(matches=False).doubted(0.02)
    assert (failed.trial, failed.lost, failed.relocations) == (0.0, True, 0)


def test_seen_again() -> None:
    again = Trust(doubt=1.0, trial=0.1, searches=4).reacquired(0.04)
    assert (again.lost, again.trial, again.searches, again.relocations) == (False, 0.0, 0, 1)
    assert again.doubted(0.04).doubted(0.04).lost, "what is found is not believed before the next picture"
