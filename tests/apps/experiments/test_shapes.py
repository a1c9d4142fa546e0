"""The experiment on deformable shapes: its measures of error, its page, and public sequences."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments import run_experiment, shapes
from rsmcm.inference.sfm.nonrigid.learning import learn_shape

from ...support.deforming import N_BASES, deforming

Numbers = NDArray[np.float64]


def test_measures_of_error() -> None:
    truth = deforming()[1]
    random = np.random.default_rng(0)
    turned = shapes.centred(truth) @ np.linalg.qr(random.standard_normal((3, 3)))[0]
    assert shapes.normalised_error(shapes.turned_onto(turned, truth), truth) < 1e-12
    mirrored = truth * [1, 1, -1] + [5, 6, 7]
    assert shapes.normalised_error(shapes.nearer_image(mirrored, truth), truth) < 1e-12
    longer = truth.mean(axis=1, keepdims=True) + 1.25 * shapes.centred(truth)
    assert shapes.normalised_error(longer, truth) == pytest.approx(0.25)


@pytest.mark.usefixtures("in_this_process")
def test_tables_and_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shapes, "data_folder", lambda name: tmp_path)
    monkeypatch.setattr(shapes, "read_shapes", lambda path: deforming(n_frames=20)[1])
    monkeypatch.setattr(shapes, "BASES", {"face": N_BASES})
    monkeypatch.setattr(shapes, "MISSING", (0.0, 0.2))
    monkeypatch.setattr(shapes, "SEEDS", range(2))
    run_experiment("shapes", tmp_path / "out")
    printed = capsys.readouterr().out
    (line,) = (each for each in printed.splitlines() if each.startswith("face, 20% missing: 3-D error"))
    assert len(line.split()) > 8, "with the error over seeds"
    assert (tmp_path / "out" / "index.html").read_text().count("<img") == 2


@pytest.mark.parametrize("name", sorted(shapes.BASES))
@pytest.mark.slow
def test_public_sequences(name: str) -> None:
    try:
        truth = shapes.read_shapes(shapes.sequence_file(name))
    except OSError as missing:
        pytest.skip(str(missing))
    learned = learn_shape(shapes.withheld(truth[..., :2], 0.2, np.random.default_rng(0)), shapes.BASES[name])
    assert shapes.LearnedShape(name, 0.2, learned, truth).published < shapes.PUBLISHED[name]
