"""The cylinder and turning objects: cells, expectations, pictures; and one sequence in earnest."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rsmcm.apps.evaluation.structure import StructureScores
from rsmcm.apps.experiments import run_experiment
from rsmcm.apps.experiments import structure as experiment
from rsmcm.apps.experiments.experiment import Plot, by_seed
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


def test_cells_cover_the_panels_and_both_ways_of_regaining() -> None:
    cells = experiment.cells()
    assert len(set(cells)) == len(cells)
    for loose in (0.0, 0.12):
        for drift in experiment.DRIFT:
            assert Cell(loose, drift, 0.5) in cells
    for loose in experiment.LOOSE:
        for drift in (0.0, 0.2):
            assert Cell(loose, drift, 0.5) in cells
            assert (Cell(loose, drift, None) in cells) == (loose > 0)
    assert max(cell.loose for cell in cells) == 0.12
    assert max(cell.drift for cell in cells) == 0.3


def test_points_are_regained_as_the_cell_says() -> None:
    rare, often = Cell(0.1, 0.0, None).sequence(1), Cell(0.1, 0.0, 0.5).sequence(1)
    assert rare.visible.mean() < 0.7 < often.visible.mean()


def test_claims_hold_where_they_should() -> None:
    verdicts = [expectation.verdict for expectation in experiment.expectations_of(made_up())]
    assert verdicts.count("pass") == len(verdicts) - 1
    assert verdicts.count("") == 1, "missing points are only told"
    poor = {
        expectation.what: expectation.verdict for expectation in experiment.expectations_of(made_up(0.06))
    }
    assert sum(verdict == "short" for verdict in poor.values()) == 4


def test_worst_cell_decides() -> None:
    everything = made_up()
    cell = Cell(0.12, 0.3, 0.5)
    everything[cell][DUAL_COHERENT] = [replace(GOOD, reprojection_error=0.0066, purity=0.9)] * 4
    expectations = {expectation.what: expectation for expectation in experiment.expectations_of(everything)}
    assert expectations[f"{DUAL_COHERENT}: error over the oracle, P(regain) = 0.5"].measured == pytest.approx(
        1.65
    )
    assert expectations[f"{DUAL_COHERENT}: share of pure points"].measured == pytest.approx(0.9)


def test_panels() -> None:
    canvas = Figure()
    experiment.draw_panels(made_up(), canvas)
    assert [axis.get_title() for axis in canvas.axes] == [
        "P(loose) = 0",
        "P(loose) = 0.12",
        "P(drift) = 0",
        "P(drift) = 0.2",
    ]
    n_lines = [len(axis.lines) for axis in canvas.axes]
    assert n_lines == [5, 10, 10, 10]
    assert canvas.axes[3].lines[0].get_xdata().tolist() == list(experiment.LOOSE)  # type: ignore[union-attr]


def test_shapes_are_drawn_where_they_belong(tmp_path: Path) -> None:
    truth = cylinder(seed=2)
    generator = np.random.default_rng(0)
    mapped = truth.shape @ generator.normal(size=(3, 3)) + 5
    points = truth.point_of_track.copy()
    points[0] = -1
    found = experiment.Recovered(truth.positions, mapped, points)
    np.testing.assert_allclose(experiment.aligned(found, truth), truth.shape, atol=1e-10)
    shapes = dict.fromkeys(METHODS, found)
    Plot("a.png", partial(experiment.draw_shapes, shapes, truth), (9, 4), "").write(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_the_methods_on_one_sequence() -> None:
    """What is wanted of medians over 20 sequences holds on this one, with some room."""
    scores = experiment.scores(Cell(0.06, 0.1, 0.5), seed=0)
    assert list(scores) == list(METHODS)
    dual, oracle = scores[DUAL_COHERENT], scores[ORACLE]
    assert dual.reprojection_error < 2 * oracle.reprojection_error
    assert dual.reprojection_error < 0.2 * scores[SINGLE_COHERENT].reprojection_error
    assert dual.purity >= 0.9
    assert dual.n_points <= 46


def test_all_methods_agree_where_nothing_is_lost() -> None:
    scores = experiment.scores(Cell(0.0, 0.0, 0.5), seed=0)
    for name in METHODS:
        assert scores[name].shape_error == pytest.approx(scores[ORACLE].shape_error, rel=0.05)
        assert (scores[name].n_points, scores[name].purity) == (40, 1)
    for name in (SINGLE_COHERENT, DUAL_COHERENT):
        assert scores[name].reprojection_error == pytest.approx(scores[ORACLE].reprojection_error, rel=0.02)


@pytest.mark.slow
def test_everything_in_two_processes() -> None:
    cells = [Cell(0.0, 0.0, 0.5), Cell(0.12, 0.3, None)]
    measured = by_seed("cylinder", experiment.scores, cells, range(2))
    assert list(measured) == cells
    assert measured[cells[1]][DUAL_COHERENT][1] == experiment.scores(cells[1], 1)[DUAL_COHERENT]


def test_tables_and_pictures_of_turning_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    film, out = tmp_path / "film", tmp_path / "out"
    film.mkdir()
    write_film(film, n_frames=8)
    monkeypatch.setattr(experiment, "SEQUENCES", ("film",))
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
