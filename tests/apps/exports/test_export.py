"""`rsmcm export` as a user runs it."""

import json
import re
import sys
import zipfile
from pathlib import Path

import pytest

from ...conftest import Command, names

EXPORT = Command("export")


def test_it_says_what_it_has_written(
    background: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for to, suffix in (("coco", "json"), ("cvat", "zip"), ("movement", "nc")):
        out = tmp_path / f"{to}.{suffix}"
        assert EXPORT(background, "--to", to, "--out", out) == 0
        assert capfd.readouterr().out.endswith(f": {out}\n")
    assert names(tmp_path) == {"coco.json", "cvat.zip", "movement.nc"}
    assert json.loads((tmp_path / "coco.json").read_text())["annotations"]
    assert zipfile.is_zipfile(tmp_path / "cvat.zip")


@pytest.mark.parametrize(
    ("to", "name", "wrong"),
    [
        ("coco", "a.json", "got results of rsmcm body, expected rsmcm background"),
        ("cvat", "a.zip", "got results of rsmcm body, expected rsmcm background"),
        ("coco", "a.zip", "--out: got .*, expected a name that ends with .json"),
        ("movement", "a.json", "--out: got .*, expected a name that ends with .nc"),
    ],
)
def test_what_does_not_go_is_one_line(
    body: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], to: str, name: str, wrong: str
) -> None:
    line = EXPORT.complaint(capfd, body, "--to", to, "--out", tmp_path / name)
    assert re.search(wrong, line)
    assert names(tmp_path) == set()


def test_a_file_that_is_there_is_kept_unless_it_may_be_replaced(
    background: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.json"
    out.write_text("mine")
    assert "use --overwrite" in EXPORT.complaint(capfd, background, "--to", "coco", "--out", out)
    assert out.read_text() == "mine"
    assert EXPORT(background, "--to", "coco", "--out", out, "--overwrite") == 0
    assert json.loads(out.read_text())["images"]


def test_a_package_that_is_missing_is_named(
    background: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    line = EXPORT.complaint(capfd, background, "--to", "movement", "--out", tmp_path / "a.nc")
    assert "this needs xarray: pip install 'rsmcm[xarray]'" in line
