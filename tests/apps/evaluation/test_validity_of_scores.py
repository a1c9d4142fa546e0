"""Whether combining pays, from log densities: against densities that are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.command_line import main
from rsmcm.apps.evaluation.predictions import FILE, ScoreRecord, read_predictions, write_predictions
from rsmcm.apps.evaluation.validity import TooFewError, report_validity
from rsmcm.inference.validity import compare_scores
from scipy.stats import norm

Numbers = NDArray[np.float64]


def scores(correlation: float, count: int, seed: int = 0) -> Numbers:
    """Of two chains that predict a number with unit errors, and take them for independent."""
    errors = np.random.default_rng(seed).multivariate_normal(
        np.zeros(2), [[1, correlation], [correlation, 1]], count
    )
    seen = np.random.default_rng(seed + 1).normal(0, 0.5, count)
    each = norm.logpdf(seen[:, None], errors, np.sqrt(1.25))
    product = norm.logpdf(seen, errors.mean(axis=1), np.sqrt(0.75))
    return np.column_stack([each, product])


def expected_gain(correlation: float) -> float:
    """By the moments of the errors: mean log densities of Gaussians."""
    alone = -0.5 * np.log(2 * np.pi * 1.25) - 0.5
    together = -0.5 * np.log(2 * np.pi * 0.75) - 0.5 * (0.25 + (1 + correlation) / 2) / 0.75
    return float(together - alone)


@pytest.mark.parametrize(
    ("correlation", "verdict"), [(0.0, "helps"), (0.3, "helps"), (0.95, "does not help")]
)
def test_gain_is_that_of_the_densities(correlation: float, verdict: str) -> None:
    found = compare_scores(scores(correlation, 20_000), np.arange(20_000) // 100)
    four = found.gain.high - found.gain.low  # standard errors
    off = found.gain.estimate - expected_gain(correlation)
    assert -four - 0.01 < off < four  # over the better of two chance means
    assert found.verdict == verdict
    assert np.sign(expected_gain(correlation)) == (1 if verdict == "helps" else -1)


def test_intervals_hold_what_they_should() -> None:
    held = 0
    for seed in range(60):
        found = compare_scores(scores(0.3, 600, 2 * seed), np.arange(600) // 15, resamples=300)
        held += found.product.low < -0.5 * np.log(2 * np.pi * 0.75) - 0.5 * 0.9 / 0.75 < found.product.high
    assert held >= 50


def record(correlation: float = 0.0) -> ScoreRecord:
    return ScoreRecord("one", "two", "pixels", "a pixel", scores(correlation, 400), np.arange(1, 401))


def test_the_command_says_it_in_a_table_and_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_predictions(tmp_path, [record()])
    (read,) = read_predictions(tmp_path)
    assert isinstance(read, ScoreRecord)
    np.testing.assert_array_equal(read.scores, record().scores)
    with pytest.raises(SystemExit):
        main(["validity", str(tmp_path)])
    said = capsys.readouterr().out
    assert "one + two  pixels" in said
    assert "one + two on pixels: helps. The product scores" in said
    assert "nats a pixel" in said


@pytest.mark.parametrize("broken", [np.zeros((400, 2)), np.full((400, 3), np.nan), np.zeros((399, 3))])
def test_broken_scores_are_one_line(
    broken: Numbers, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_predictions(tmp_path, [record()])
    with np.load(tmp_path / FILE) as members:
        arrays = {name: members[name] for name in members.files}
    np.savez(tmp_path / FILE, **{**arrays, "0/scores": broken})
    with pytest.raises(SystemExit):
        main(["validity", str(tmp_path)])
    (line,) = capsys.readouterr().err.splitlines()
    assert FILE in line
    assert "scores" in line


def test_a_pair_of_which_there_is_too_little_keeps_no_other_from_being_judged(tmp_path: Path) -> None:
    short = record().rows(np.array([0]))
    write_predictions(tmp_path, [replace(short, first="three"), record()])
    said = report_validity(tmp_path)
    assert "one + two on pixels: helps." in said
    assert said.endswith("three + two: got scores of one frame, expected more.")
    write_predictions(tmp_path, [short])
    with pytest.raises(TooFewError, match=r"one \+ two: got scores of one frame"):
        report_validity(tmp_path)
