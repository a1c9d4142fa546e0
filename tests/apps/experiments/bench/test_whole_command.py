"""What is judged of a command: the part of a film behind its beginning."""

import pytest
from rsmcm.apps.experiments.bench import whole_command


def test_what_is_done_once_counts_for_the_whole_film_only() -> None:
    frames = whole_command.LONG - whole_command.SHORT
    for once in (0.5, 3.0):
        spent = {"short": once + 0.25, "long": once + 0.25 + 0.01 * frames}
        spent |= {"begun": 0.3, "engine": 0.3 + 0.008 * frames}
        rate, whole, engine, over = whole_command._of_commands(spent)
        assert rate.measured == pytest.approx(100)
        assert whole.measured == pytest.approx(whole_command.LONG / spent["long"])
        assert engine.measured == pytest.approx(8)
        assert (over.measured, over.verdict) == (pytest.approx(1.25), "pass")
