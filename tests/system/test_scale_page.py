"""The page on many films: its commands run as printed, and what they leave is what it says."""

import csv
from pathlib import Path

import pytest

from ..support.films import write_film
from ..support.pages import ROOT, Reader

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs" / "scale.md"


def test_the_page_can_be_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for number, name in enumerate(("gate", "yard")):
        write_film(Path("films") / f"{name}.mp4", seed=number)  # a folder of images, for brevity
    read = Reader(PAGE).read()
    for folder in ("films", "cameras"):
        with Path("results", folder, "summary.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert [row["folder"] for row in rows] == ["gate", "yard"]
        assert {row["state"] for row in rows} == {"complete"}
        assert ", ".join(rows[0]) in PAGE.read_text()
    assert not Path("results/cameras/gate/foreground").exists()
    printed = [line for line in read.printed if line.startswith("rsmcm background ")]
    assert len(printed) == 2
