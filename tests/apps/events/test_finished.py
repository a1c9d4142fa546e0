"""Events from a finished run: those that the run itself writes, for any zones."""

import json
import re
import shutil
from pathlib import Path

import cv2
import pytest
from rsmcm.apps.command_line import main
from rsmcm.apps.events import Kind, read_events
from rsmcm.apps.scenes import sleeping_man

ZONES = """
[[zone]]
name = "left half"
polygon = [[0, 0], [80, 0], [80, 120], [0, 120]]

[[line]]
name = "gate"
from = [40, 120]
to = [40, 60]
left_to_right = "in"
right_to_left = "out"
"""


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["--quiet", *map(str, arguments)])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of 8 s: a man walks in at the left and stands in the middle; zones beside it."""
    folder = tmp_path_factory.mktemp("film")
    (folder / "input").mkdir()
    for frame in sleeping_man(200, size=(160, 120), enter=20, car_leaves=200):
        assert frame.image is not None
        cv2.imwrite(str(folder / "input" / f"{frame.number:03d}.png"), frame.image)
    (folder / "zones.toml").write_text(ZONES)
    return folder


@pytest.fixture(scope="module")
def results(film: Path) -> Path:
    """Of a run that was given the zones."""
    zones = film / "zones.toml"
    assert run("background", film / "input", "--out", film / "out", "--masks", "none", "--zones", zones) == 0
    return film / "out"


def test_the_run_writes_what_happened(results: Path) -> None:
    found = read_events(results / "events.csv")
    assert [(event.kind, event.zone, event.direction) for event in found] == [
        (Kind.APPEARED, "left half", ""),
        (Kind.CROSSED, "gate", "in"),
        (Kind.STANDS, "left half", ""),
        (Kind.STOOD, "left half", ""),
        (Kind.REMAINED, "left half", ""),
    ]
    summary = json.loads((results / "summary.json").read_text())
    assert summary["events"]["gate"] == {"in": 1, "out": 0}
    zone = summary["events"]["left half"]
    assert (zone["appeared"], zone["remained"], zone["stands"], zone["entered"]) == (1, 1, 1, 0)
    assert zone["longest_dwell"] == pytest.approx(found[-1].duration)
    assert "events.csv" in json.loads((results / "manifest.json").read_text())["files"]
    page = (results / "view.html").read_text()
    assert "Zones and lines" in page
    assert "in left half" in page
    assert '"name": "left half"' in re.sub(r"\s*:\s*", ": ", (results / "view.html").read_text())


def test_the_finished_run_gives_the_same(results: Path, film: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(results, tmp_path / "copy")
    (copy / "events.csv").unlink()
    assert run("events", copy, "--zones", film / "zones.toml") == 0
    assert (copy / "events.csv").read_bytes() == (results / "events.csv").read_bytes()
    one, other = (json.loads((folder / "summary.json").read_text()) for folder in (copy, results))
    assert one == other
    assert "events.html" in json.loads((copy / "manifest.json").read_text())["files"]
    assert "Zones and lines" in (copy / "events.html").read_text()


def test_zones_can_be_changed(results: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(results, tmp_path / "copy")
    (tmp_path / "zones.toml").write_text(ZONES.replace("left half", "half").replace("80", "120"))
    assert run("events", copy, "--zones", tmp_path / "zones.toml") == 0
    assert [event.zone for event in read_events(copy / "events.csv")] == ["half", "gate", *["half"] * 3]
    assert list(json.loads((copy / "summary.json").read_text())["events"]) == ["half", "gate"]
    assert 'href="view.html"' in (copy / "events.html").read_text()


def test_what_is_wrong_is_one_line_and_loses_nothing(
    results: Path, film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def fails(*arguments: object) -> str:
        assert run(*arguments) == 2
        (line,) = capfd.readouterr().err.splitlines()
        return line

    bad = tmp_path / "zones.toml"
    bad.write_text(ZONES.replace("[80, 120]", "[80, 121]"))
    before = {path.name: path.read_bytes() for path in results.iterdir() if path.is_file()}
    line = fails("events", results, "--zones", bad)
    assert line.startswith(f"rsmcm: --zones: {bad}: zone 1 (left half): polygon: corner 3: got [80, 121]")
    assert fails("background", film / "input", "--out", results, "--overwrite", "--zones", bad) == line
    resumed = ("--out", results, "--resume", "--masks", "none", "--zones", bad)
    assert "other parameters than in the saved run: zones.file" in fails(
        "background", film / "input", *resumed
    )
    assert {path.name: path.read_bytes() for path in results.iterdir() if path.is_file()} == before
    assert "No such file" in fails("events", results, "--zones", tmp_path / "none.toml")
    assert "expected the folder of a finished run" in fails("events", tmp_path / "none", "--zones", bad)
    assert "holds no tracks.csv; it is written by: rsmcm background" in fails("events", film, "--zones", bad)
    (tmp_path / "broken").mkdir()
    for name in ("tracks.csv", "manifest.json"):
        shutil.copy(results / name, tmp_path / "broken")
    (tmp_path / "broken" / "summary.json").write_text('{"size": [160, "a"]}')
    assert "expected the summary of rsmcm background" in fails("events", tmp_path / "broken", "--zones", bad)
    stand_alone = ("--engine", "stand-alone", "--zones", film / "zones.toml")
    line = fails("background", film / "input", "--out", tmp_path / "out", *stand_alone)
    assert line == "rsmcm: --zones and --engine stand-alone: got both, expected one of them"
