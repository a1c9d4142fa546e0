"""The experiment with turning objects, on a short generated film in place of the public ones."""

from pathlib import Path

import pytest
from rsmcm.apps.experiments import box, run_experiment

from ...support.reconstructions import write_film


def test_tables_and_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    film, out = tmp_path / "film", tmp_path / "out"
    film.mkdir()
    write_film(film, n_frames=8)
    monkeypatch.setattr(box, "SEQUENCES", ("film",))
    monkeypatch.setattr(box, "data_folder", lambda name: film)
    run_experiment("box", out)
    printed = capsys.readouterr().out
    assert "film: median length of tracks, over stand-alone" in printed
    assert "film: reprojection error, over stand-alone" in printed
    assert [line.split()[1] for line in printed.splitlines()[2:4]] == ["stand-alone", "dual-chain"]
    assert {"index.html", "film-stand-alone.png", "film-dual-chain.png"} <= {
        path.name for path in out.iterdir()
    }
    assert (out / "index.html").read_text().count('alt="film-') == 2
