"""The cylinder and turning objects: cells, expectations, pictures; and one sequence in earnest."""

from dataclasses import replace
from pathlib import Path

import pytest
from rsmcm.apps.evaluation.structure import StructureScores
from rsmcm.apps.experiments import run_experiment
from rsmcm.apps.experiments import structure as experiment
from rsmcm.apps.experiments.structure import DUAL_COHERENT, METHODS, ORACLE, SINGLE, SINGLE_COHERENT, Cell

from ...support.reconstructions import write_film

GOOD = StructureScores(0.004, 0.003, 40, 0, 0, 2, 1.0)


def made_up(dual_error: float = 0.004) -> dict[Cell, experiment.Measured]:
    """Scores as they are hoped for: single chains fail where points are lost."""
    everything = {}
    for cell in experiment.cells():
        poor = replace(GOOD, reprojection_error=0.5 if cell.loose else 0.004)
        dual = replace(GOOD, reprojection_error=dual_error)
        values = {**dict.fromkeys(METHODS, GOOD), SINGLE: poor, SINGLE_COHERENT: poor, DUAL_COHERENT: dual}
        everything[cell] = {
            name: [replace(one, n_points=40 + seed % 2) for seed in range(4)] for name, one in values.items()
        }
    return everything


def test_claims_hold_where_they_should() -> None:
    verdicts = [expectation.verdict for expectation in experiment.expectations_of(made_up())]
    assert verdicts.count("pass") == len(verdicts) - 1
    assert verdicts.count("") == 1, "missing points are only told"
    poor = {
        expectation.what: expectation.verdict for expectation in experiment.expectations_of(made_up(0.06))
    }
    assert sum(verdict == "short" for verdict in poor.values()) == 4


def test_the_methods_on_one_sequence() -> None:
    """What is wanted of medians over 20 sequences holds on this one, with some room."""
    scores = experiment.scores(Cell(0.06, 0.1, 0.5), seed=0)
    assert list(scores) == list(METHODS)
    dual, oracle = scores[DUAL_COHERENT], scores[ORACLE]
    assert dual.reprojection_error < 2 * oracle.reprojection_error
    assert dual.reprojection_error < 0.2 * scores[SINGLE_COHERENT].reprojection_error
    assert dual.purity >= 0.9
    assert dual.n_points <= 46


@pytest.mark.usefixtures("in_this_process")
def test_tables_and_pictures_of_turning_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    film, out = tmp_path / "film", tmp_path / "out"
    film.mkdir()
    write_film(film, n_frames=8)
    monkeypatch.setattr(experiment, "SEQUENCES", ("film",))
    monkeypatch.setattr(experiment, "NOISE_SEEDS", range(1))
    monkeypatch.setattr(experiment, "data_folder", lambda name: film)
    run_experiment("box", out)
    printed = capsys.readouterr().out
    assert "film: median length of tracks, over stand-alone" in printed
    assert "film: reprojection error, over stand-alone" in printed
    assert [line.split()[1] for line in printed.splitlines()[2:4]] == ["stand-alone", "dual-chain"]
    assert {"index.html", "film-stand-alone.png", "film-dual-chain.png"} <= {
        path.name for path in out.iterdir()
    }
    assert (out / "index.html").read_text().count('alt="film-') == 2
