"""The cylinder and turning objects: cells, expectations, pictures; and one sequence in earnest."""

from dataclasses import replace
from pathlib import Path

import pytest
from rsmcm.apps.evaluation.structure import StructureScores, score_structure
from rsmcm.apps.experiments import run_experiment
from rsmcm.apps.experiments import structure as experiment
from rsmcm.apps.experiments.structure import DUAL_COHERENT, METHODS, ORACLE, SINGLE, SINGLE_COHERENT, Cell
from rsmcm.apps.scenes import cylinder

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
    assert sum(verdict == "missed" for verdict in poor.values()) == 4


def test_the_methods_on_one_short_sequence() -> None:
    """How much better both chains are is a matter of 20 sequences, and of the experiment."""
    truth = cylinder(n_points=20, n_frames=36, p_loose=0.06, p_drift=0.1, seed=0)
    recovered = experiment.recover(truth)
    assert list(recovered) == list(METHODS)
    scores = {
        name: score_structure(each.positions, each.shape, each.point_of_track, truth)
        for name, each in recovered.items()
    }
    dual, oracle = scores[DUAL_COHERENT], scores[ORACLE]
    assert oracle.reprojection_error < 1.02 * min(each.reprojection_error for each in scores.values())
    assert dual.reprojection_error < 0.8 * scores[SINGLE_COHERENT].reprojection_error
    assert dual.purity >= 0.75
    assert 16 <= dual.n_points <= 26


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
    assert [line.split()[1] for line in printed.splitlines()[3:5]] == ["stand-alone", "dual-chain"]
    assert {"index.html", "film-stand-alone.png", "film-dual-chain.png"} <= {
        path.name for path in out.iterdir()
    }
    assert (out / "index.html").read_text().count('alt="film-') == 2
