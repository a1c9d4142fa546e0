"""Films of a few px across: pictures of them stay small, and nothing is lost."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from ..conftest import Command, names, summary_of

pytestmark = pytest.mark.slow

SIZES = [(2, 4000), (4000, 2)]


@pytest.fixture(params=SIZES, ids=str)
def film(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    width, height = request.param
    with av.open(str(tmp_path / "thin.mkv"), "w") as file:
        stream = file.add_stream("ffv1", rate=Fraction(25))
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = width, height, "bgr0"
        for number in range(4):
            image = np.random.default_rng(number).integers(0, 256, (height, width, 3), dtype=np.uint8)
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        file.mux(stream.encode(None))
    return tmp_path / "thin.mkv"


def test_background(film: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert Command("background")(film, "--out", out) == 0
    assert {"view.html", "film.mp4", "summary.json"} <= names(out)
    assert Command("reproduce")("compare", film, "--out", tmp_path / "compared") == 0
    assert {"index.html", "compare-pictures.png"} <= names(tmp_path / "compared")
    assert summary_of(out)["frames"] == 4


def test_body(film: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert Command("body")(film, "--out", out, "--head", "0,0,2,2", "--samples", 20) == 0
    assert {"view.html", "film.mp4", "summary.json"} <= names(out)
