"""`rsmcm export --to video`: the film of a run with what was found drawn on it."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.exports import to_video
from rsmcm.apps.view.film import read_film

from ...conftest import Command
from ...support.film import read_video

EXPORT = Command("export")


@pytest.mark.parametrize("name", ["background", "body"])
def test_every_frame_is_drawn_on(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    run, out = request.getfixturevalue(name), tmp_path / "video.mp4"
    film = read_film(run)
    assert to_video(run, out) == f"{len(film.numbers)} frames"
    plain, _ = read_video(run / "film.mp4")
    drawn, times = read_video(out)
    assert len(drawn) == len(plain)
    np.testing.assert_allclose(times, film.times - film.times[0], atol=0.02)
    width, height = film.size
    for one, other in zip(drawn[1:], plain[1:], strict=True):
        assert one.shape[0] >= height
        if one.shape == other.shape:
            assert (np.abs(one.astype(int) - other)[:height, :width] > 60).any(axis=2).mean() < 0.5
    assert [path.name for path in tmp_path.iterdir()] == ["video.mp4"]


def test_what_has_no_film_is_said(
    background: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    shutil.copytree(background, run)
    (run / "film.mp4").write_bytes(b"no film")
    assert "got a damaged film" in EXPORT.complaint(capfd, run, "--to", "video", "--out", tmp_path / "a.mp4")
    (run / "film.mp4").unlink()
    assert "holds no film" in EXPORT.complaint(capfd, run, "--to", "video", "--out", tmp_path / "a.mp4")
    assert {path.name for path in tmp_path.iterdir()} == {"run"}
