"""Body trackers compared: expectations on made-up trials, counts of samples, a run on short scenes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from rsmcm.apps.body.measures import BodyTrial
from rsmcm.apps.body.overlay import TrackedBody
from rsmcm.apps.experiments.reproduce import body, run_experiment

from ....conftest import names

N_FRAMES = 30
NAMES = [body.RSMCM.name, body.SAMPLER.name, *map(body.CONDENSATION.format, body.MULTIPLES), body.FLESH.name]


def trial(error: float, seconds: float = 0.05, square: float = 1.0) -> BodyTrial:
    errors = np.full((N_FRAMES, 4), error)
    return BodyTrial(
        errors,
        errors + 1,
        np.full((N_FRAMES, 2), square),
        np.full(N_FRAMES, 300.0),
        np.full(N_FRAMES, seconds),
        np.zeros((N_FRAMES, 2), np.bool_),
        np.zeros(N_FRAMES),
        80.0,
    )


def half_in_region(one: BodyTrial, share: float) -> BodyTrial:
    nees = np.ones((N_FRAMES, 2))
    nees[: round((1 - share) * N_FRAMES)] = 9.0
    return replace(one, nees=nees)


def made_up(rsmcm: float, sampler: float, clouds: tuple[float, ...]) -> body.Found:
    found = {
        body.RSMCM.name: [half_in_region(trial(rsmcm), 0.9)] * 2,
        body.SAMPLER.name: [trial(sampler)] * 2,
        body.FLESH.name: [trial(np.nan, 0.02)] * 2,
    }
    for times, error in zip(body.MULTIPLES, clouds, strict=True):
        found[body.CONDENSATION.format(times)] = [trial(error, 0.05 * times)] * 2
    return found


def test_claims_hold_where_the_paper_is_right() -> None:
    expectations = body.expectations_of(made_up(8, 20, (24, 18, 9.9, 9)))
    assert [expectation.verdict for expectation in expectations] == ["pass"] * 6
    assert expectations[0].measured == pytest.approx(0.4)
    assert expectations[1].measured == pytest.approx(8 / 24)
    assert expectations[2].measured == pytest.approx(3.0)


def test_claims_fall_short_where_it_is_not() -> None:
    expectations = body.expectations_of(made_up(8, 10, (9, 9, 9, 9)))
    assert [expectation.verdict for expectation in expectations] == [
        "short",
        "short",
        "short",
        "pass",
        "pass",
        "pass",
    ]
    assert expectations[2].measured == pytest.approx(1.0)


def test_it_is_said_when_no_time_was_enough() -> None:
    expectation = body.expectations_of(made_up(8, 20, (24, 24, 24, 24)))[2]
    assert expectation.measured == pytest.approx(body.MULTIPLES[-1])
    assert "more than" in expectation.what


def test_mis_tracks_count_for_the_recovered_share() -> None:
    found = made_up(8, 20, (24, 18, 9.9, 9))
    errors = np.full((N_FRAMES, 4), 8.0)
    errors[2:5, 1] = 60.0  # three frames
    errors[10:25, 3] = 60.0  # fifteen, in which the hand is seen
    found[body.RSMCM.name] = [replace(found[body.RSMCM.name][0], errors=errors)] * 2
    expectation = body.expectations_of(found)[3]
    assert expectation.measured == 0.5
    assert "4 mis-tracks" in expectation.what
    assert expectation.verdict == "short"


def test_samples_of_a_time_lie_on_a_line() -> None:
    few, many = body.TIMED_SAMPLES
    assert body.samples_in(0.030, (0.030, 0.070)) == few
    assert body.samples_in(0.070, (0.030, 0.070)) == many
    assert body.samples_in(0.050, (0.030, 0.070)) == (few + many) // 2
    assert body.samples_in(0.190, (0.030, 0.070)) == pytest.approx(many + 3 * (many - few), rel=0.05)
    assert body.samples_in(0.001, (0.030, 0.070)) == body.FEWEST_SAMPLES
    assert body.samples_in(0.035, (0.030, 0.07)) == 3000, "two digits"


def test_cells_of_what_is_not_known() -> None:
    assert body.errors_of([trial(np.nan)])[0] == "–"
    row = body.behaviour_of([trial(4.0, 0.1)], [trial(4.0)])
    assert row[3] == pytest.approx(2.0)
    assert row[-2:] == [0.0, "–"]
    errors = body.errors_of([trial(4.0)])
    assert errors == pytest.approx([4, 0.05, 4, 4, 4, 5, 5])


def test_plots() -> None:
    canvas = Figure()
    body.draw_errors(canvas, made_up(8, 20, (24, 18, 9.9, 9)))
    assert len(canvas.axes[0].lines) == len(NAMES) - 1


def test_every_result_stands_at_its_tracker_and_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run with everything but the trackers themselves."""

    def numbered(label: str, work: list[tuple[Any, tuple[Any, ...]]]) -> list[list[BodyTrial]]:
        trials = []
        for _, (trackers, scene, *shown) in work:
            row = []
            for place, tracker in enumerate(trackers):
                one = trial(1.0 + place + scene["seed"] / 10, 0.01 + 1e-5 * tracker.samples)
                pictures = {
                    index: TrackedBody(np.ones((40, 8, 3)), np.ones((8, 3)), np.ones((8, 1, 1)) * np.eye(3))
                    for index in (shown[0] if shown else ())
                }
                row.append(replace(one, shown=pictures))
            trials.append(row)
        return trials

    monkeypatch.setattr(body, "in_parallel", numbered)
    monkeypatch.setattr(body, "SHOWN", (1, 2))
    monkeypatch.setattr(body, "SCENE", {"n_frames": 3, "detector_dropout": 0.2})
    run_experiment("body", tmp_path / "out")
    assert names(tmp_path / "out") == {"index.html", "fig-6.png", "errors.png", "results.json"}
    results = json.loads((tmp_path / "out" / "results.json").read_text())["runs"]
    assert list(results) == NAMES
    for place, name in enumerate(NAMES):
        assert results[name]["error"] == pytest.approx([1.0 + place + seed / 10 for seed in body.SEEDS])
    assert results[NAMES[2]]["samples"] == 1000
    assert results[NAMES[3]]["samples"] == 3000
    printed = capsys.readouterr().out
    assert "likelihood sampler" in printed
    assert "recovered within 10 frames" in printed


@pytest.mark.slow
def test_short_scenes_in_earnest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(body, "SEEDS", range(2))
    monkeypatch.setattr(body, "SCENE", {"n_frames": 12})
    monkeypatch.setattr(body, "TIMED_FRAMES", 8)
    monkeypatch.setattr(body, "SHOWN", (4, 9))
    run_experiment("body", tmp_path / "out")
    results = json.loads((tmp_path / "out" / "results.json").read_text())["runs"]
    counts = [results[body.CONDENSATION.format(times)]["samples"] for times in body.MULTIPLES]
    assert counts == sorted(counts)
    assert all(0 < error < 300 for error in results[body.RSMCM.name]["error"])
    assert "a hand off" in capsys.readouterr().out
