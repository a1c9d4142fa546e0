"""What the experiments are put together from: tables, figures, methods, and the check against enumeration."""

from pathlib import Path

import pytest
from rsmcm.apps.evaluation.masks import PixelScore, joined
from rsmcm.apps.experiments import masks as experiment
from rsmcm.apps.experiments import run_experiment
from rsmcm.apps.experiments.record import Expectation
from rsmcm.apps.scenes import sleeping_man

SIZE = (96, 72)


def test_claims_say_whether_they_hold() -> None:
    assert Expectation("x", 0.3, "<=", 0.35).verdict == "pass"
    assert Expectation("x", 0.4, "<=", 0.35).verdict == "missed"
    assert Expectation("x", 1.3, ">=", 1.25).cells == ("x", ">= 1.25", "1.3", "", "pass")
    assert Expectation("x", 1291.4, standard_error=214.2).cells == ("x", "", "1291", "214", "")
    assert Expectation("x", 12345.6).cells == ("x", "", "12346", "", "")
    assert Expectation("x", float("nan"), "<=", 1).verdict == "missed"


def test_scores_of_a_scene_name_all_methods() -> None:
    scored = experiment.scores_of_scene(sleeping_man(8, size=SIZE, enter=0))
    assert [name for name, _ in scored] == ["feed-forward", "RSMCM", "MOG2", "KNN"]
    assert all(len(score.numbers) == 8 for score in scored.values())
    first, second = (joined([score]) for score in list(scored.values())[:2])
    both = joined([first, second])
    assert len(both.counts) == 16
    assert joined([]).total() == PixelScore().total()


@pytest.mark.slow
def test_sleeping_man_orders_the_methods(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_experiment("sleeping-man", tmp_path)
    printed = capsys.readouterr().out
    assert "short" not in printed, printed
    assert (tmp_path / "fig-1.png").exists()
    assert (tmp_path / "fig-7.png").exists()
