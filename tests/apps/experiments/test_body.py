"""Body trackers compared: expectations on made-up trials, counts of samples, a run on short scenes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.body.measures import BodyTrial
from rsmcm.apps.experiments import body, experiment, run_experiment
from rsmcm.apps.view.overlay import TrackedBody

from ...conftest import names

N_FRAMES = 30
LATER = body.LATER.format(body.RSMCM.name)
NAMES = [body.RSMCM.name, LATER, body.SAMPLER, body.CLOUDS[0], body.LATER.format(body.CLOUDS[0])]
NAMES += [*body.CLOUDS[1:], body.FLESH.name]


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


def made_up(rsmcm: float, later: float, sampler: float, clouds: tuple[float, ...]) -> body.TrialsByTracker:
    found = {
        body.RSMCM.name: [trial(rsmcm)] * 2,
        LATER: [half_in_region(trial(later, 0.06), 0.9)] * 2,
        body.SAMPLER: [trial(sampler)] * 2,
        body.LATER.format(body.CLOUDS[0]): [trial(2 * later)] * 2,
        body.FLESH.name: [trial(np.nan, 0.02)] * 2,
    }
    for name, times, error in zip(body.CLOUDS, body.MULTIPLES, clouds, strict=True):
        found[name] = [trial(error, 0.05 * times)] * 2
    return found


def test_claims_hold_where_the_paper_is_right() -> None:
    expectations = body.expectations_of(made_up(8, 6, 20, (24, 12)))
    assert {expectation.verdict for expectation in expectations} == {"pass", ""}
    measured = [expectation.measured for expectation in expectations]
    assert measured[:5] == pytest.approx([0.4, 8 / 24, 6 / 24, 0.5, body.MULTIPLES[-1]])
    assert "more than" in expectations[4].what


def test_claims_fall_short_where_it_is_not() -> None:
    expectations = body.expectations_of(made_up(8, 8, 10, (9, 9)))
    verdicts = [expectation.verdict for expectation in expectations]
    assert verdicts[:5] == ["short", "short", "short", "", "short"]
    assert set(verdicts[5:]) == {"pass"}
    assert expectations[4].measured == pytest.approx(1.0)
    assert "more than" not in expectations[4].what


def test_the_time_to_come_near_lies_between_those_that_were_measured() -> None:
    assert body.time_to_come_near((1, 4), (1.5, 1.0)) == pytest.approx(2.0)
    assert body.time_to_come_near((1, 2, 4), (1.5, 1.25, 1.0)) == pytest.approx(2.0)
    assert body.time_to_come_near((1, 4), (1.0, 0.9)) == 1
    assert body.time_to_come_near((1, 4), (3.0, 2.0)) == 4


def test_mis_tracks_and_exchanges_count_for_the_later_answers() -> None:
    found = made_up(8, 6, 20, (24, 12))
    errors = np.full((N_FRAMES, 4), 8.0)
    errors[2:5, 1] = 60.0  # three frames
    errors[10:25, 3] = 60.0  # fifteen, in which the hand is seen
    exchanged = np.zeros(N_FRAMES)
    exchanged[10:22] = 1
    found[LATER] = [replace(found[LATER][0], errors=errors, exchanged=exchanged), found[LATER][0]]
    recovered, *_, off, scenes = body.expectations_of(found)[5:]
    assert recovered.measured == 0.5
    assert "2 mis-tracks" in recovered.what
    assert off.measured == pytest.approx(18 / 29 / 2)
    assert scenes.measured == 1
    assert [each.verdict for each in (recovered, off, scenes)] == ["short"] * 3


def test_samples_of_a_time_lie_on_a_line() -> None:
    few, many = counts = (2000, 10_000)
    assert body.samples_in(0.030, counts, (0.030, 0.070)) == few
    assert body.samples_in(0.070, counts, (0.030, 0.070)) == many
    assert body.samples_in(0.050, counts, (0.030, 0.070)) == (few + many) // 2
    assert body.samples_in(0.190, counts, (0.030, 0.070)) == pytest.approx(many + 3 * (many - few), rel=0.05)
    assert body.samples_in(0.001, counts, (0.030, 0.070)) == body.FEWEST_SAMPLES
    assert body.samples_in(0.035, counts, (0.030, 0.07)) == 3000, "two digits"


def test_every_result_stands_at_its_tracker_and_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run with everything but the trackers themselves."""

    def numbered(label: str, work: list[tuple[Any, tuple[int, int]]]) -> list[dict[str, BodyTrial]]:
        found = []
        for measure, (_, seed) in work:
            trackers, _, shown = measure.args
            row: dict[str, BodyTrial] = {}
            for place, tracker in enumerate(trackers):
                one = trial(1.0 + place + seed / 10, 0.01 + 1e-5 * tracker.samples)
                pictures = {
                    index: TrackedBody(np.ones((40, 8, 3)), np.ones((8, 3)), np.ones((8, 1, 1)) * np.eye(3))
                    for index in shown
                }
                row[tracker.name] = replace(one, shown=pictures)
                if tracker.lag:
                    later = replace(row[tracker.name], errors=one.errors / 2)
                    row[body.LATER.format(tracker.name)] = later
            found.append(row)
        return found

    monkeypatch.setattr(experiment, "in_parallel", numbered)
    monkeypatch.setattr(body, "SHOWN", (1, 2))
    monkeypatch.setattr(body, "SCENE", {"n_frames": 3, "detector_dropout": 0.2})
    run_experiment("body", tmp_path / "out")
    assert names(tmp_path / "out") == {"index.html", "fig-6.png", "results.json"}
    record = json.loads((tmp_path / "out" / "results.json").read_text())
    errors = {name: (samples, error) for name, samples, error, *_ in record["tables"][0]["rows"]}
    assert list(errors) == NAMES
    for place, name in enumerate(name for name in NAMES if "later" not in name):
        assert errors[name][1] == pytest.approx(np.mean([1.0 + place + seed / 10 for seed in body.SEEDS]))
    assert errors[LATER][1] == pytest.approx(np.mean([0.5 + seed / 20 for seed in body.SEEDS]))
    assert errors[body.CLOUDS[0]][0] == 1000
    assert errors[body.CLOUDS[1]][0] == 5400
    printed = capsys.readouterr().out
    assert "likelihood sampler" in printed
    assert "recovered within 10 frames" in printed


@pytest.mark.slow
def test_short_scenes_in_earnest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(body, "SEEDS", range(2))
    monkeypatch.setattr(body, "SCENE", {"n_frames": 18})
    monkeypatch.setattr(body, "TIMED_FRAMES", 18)
    monkeypatch.setattr(body, "SHOWN", (4, 9))
    run_experiment("body", tmp_path / "out")
    tables = json.loads((tmp_path / "out" / "results.json").read_text())["tables"]
    errors = {name: (samples, error) for name, samples, error, *_ in tables[0]["rows"]}
    counts = [errors[name][0] for name in body.CLOUDS]
    assert counts == sorted(counts)
    assert 0 < errors[body.RSMCM.name][1] < 300
    assert "a hand off" in capsys.readouterr().out
