"""The commands and the code on the pages of docs run; `support/pages.py` says how the pages are read."""

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.demo import N_FRAMES, write_scene
from rsmcm.apps.experiments import EXPERIMENTS
from rsmcm.apps.io.tracks import COLUMNS
from rsmcm.apps.scenes import sleeping_man
from scipy.io import loadmat

from ..support import films, stand_ins
from ..support.newcomer import write_demo, write_film
from ..support.pages import Reader, blocks, pages

OF_THEIR_OWN = {
    "own-chain": "test_own_chain.py",
    "detectors": "test_detectors_page.py",
    "keypoints": "test_keypoints_page.py",
}
PAGES = {name: path for name, path in pages().items() if name not in OF_THEIR_OWN}

WHOLE_SCENE = ("events", "validity")
"""Pages that show results of the demo's scene, which cannot be a shorter one."""

NOT_RUN_BLOCKS = {
    "detectors": 1,  # networks of others
    "figures": 2,  # data of others; the bench, which takes minutes
    "keypoints": 1,  # the same
    "parameters": 1,  # films with ground truth, and an hour
    "recipes": 2,  # a camera, a proxy
    "running": 2,  # a camera, a container
    "scale": 2,  # a cluster
    "start": 1,  # pip install
    "structure": 1,  # a camera
    "validity": 1,  # any run
}
"""How many blocks of a page are not run; every other block is."""


@pytest.fixture(scope="module")
def newcomer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that a newcomer has."""
    folder = tmp_path_factory.mktemp("newcomer")
    write_demo(folder)
    write_film(folder, sleeping_man(60, enter=0))
    for number, name in enumerate(("gate", "yard")):
        films.write_film(folder / "films" / f"{name}.mp4", seed=number)  # a folder of images, for brevity
    return folder


def test_the_code_of_readme_runs(newcomer: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(shutil.copytree(newcomer, tmp_path / "here"))
    names = Reader(PAGES["README"]).read(commands=False).names
    assert names["tracker"].state.run.number == 60
    assert len(names["objects"]) > 0
    assert PAGES["README"].read_text().count("\n") <= 150


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, path in PAGES.items() if blocks(path)])
def test_a_page_can_be_typed(
    name: str, newcomer: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From its first line to its last, in a folder of its own, with short scenes in place of the demo's."""
    here = tmp_path / "here"
    shutil.copytree(newcomer, here)
    monkeypatch.chdir(here)
    if name in WHOLE_SCENE:
        write_scene(sleeping_man(N_FRAMES), Path("results/demo/scene"))
    if name == "recipes":
        stand_ins.install(monkeypatch, here)
    reader = Reader(PAGES[name]).read()
    CHECKS.get(name, lambda reader: None)(reader)


def test_all_but_a_few_blocks_are_run() -> None:
    left_out = {name: sum(not block.run for block in blocks(path)) for name, path in pages().items()}
    assert {name: count for name, count in left_out.items() if count} == NOT_RUN_BLOCKS
    for name, path in pages().items():
        for block in blocks(path):
            where = f"{name}, line {block.line}"
            assert block.language in ("python", "sh", "output", "toml", "csv", "json", "text"), where
            assert len(block.info) == 1 or block.language not in ("python", "sh") or not block.run, where


def test_every_experiment_is_among_the_figures() -> None:
    text = pages()["figures"].read_text()
    for name in EXPERIMENTS:
        assert f"```sh\nrsmcm reproduce {name}\n```\n\n```{{record}} {name}\n```" in text


@pytest.mark.parametrize("name", pages())
def test_files_that_are_named_are_there(name: str) -> None:
    path = pages()[name]
    for link in re.findall(r"\]\((?!https?:|mailto:|#)([^)#\s]+)", path.read_text()):
        if not link.startswith(("generated/", "../generated/")):  # by Sphinx, which looks for these itself
            assert (path.parent / link).exists(), link


def result_files(name: str, folder: str) -> None:
    """The files of which the page has a table are in the folder, but for those that an option asks for."""
    listed = re.findall(r"^\| `([^`]+)` \| (?!with `--)", PAGES[name].read_text(), re.MULTILINE)
    assert len(listed) > 2
    for file in listed:
        if not file.endswith("/"):
            assert (Path("results") / folder / file).stat().st_size > 0, file


def check_background(reader: Reader) -> None:
    result_files("background", "street")
    assert len(list(Path("results/part/foreground").iterdir())) == 4
    tuned = json.loads(Path("results/tuned/summary.json").read_text())
    assert tuned["parameters"]["background"]["settle_time"] == 10


def check_bodies(reader: Reader) -> None:
    result_files("bodies", "body")
    assert json.loads(Path("results/body/summary.json").read_text())["seen"]["head"] > 0.8
    names = reader.names
    assert names["joints"].shape == (8, 3)
    off = names["joints"][0, :2] - names["signing"].joints[-1, 0, :2]
    assert (abs(off) < 0.3 * names["body"].head_height).all()
    assert names["last"]["condensation"].effective > 1


def check_python(reader: Reader) -> None:
    names = reader.names
    found = [(names[mask][names["person"]] > 0).mean() for mask in ("with_feedback", "without_feedback")]
    assert found[0] > found[1] + 0.2
    assert len(list(Path("found/foreground").iterdir())) == 60
    assert names["scores"].n_frames > 40
    assert "<svg" in names["model"]._repr_svg_()
    assert reader.printed[0].endswith("with feedback,")
    assert names["evidence"] < 0
    assert names["about"] == {"camera": "street"}
    assert names["state"].number == 15
    assert 0 < names["height"][0] < names["height"][1] < 240
    assert names["belief"].frame.number == 30
    assert "<svg" in Path("model.svg").read_text()


def check_files(reader: Reader) -> None:
    """The tables name what is there but for what an option asks for, and other tools have read it."""
    listed = {}
    for part in PAGES["files"].read_text().split("\n## ")[1:]:
        rows = re.findall(r"^\| (`[^|]+) \| (?!with `--)", part, re.MULTILINE)
        listed[part.partition("\n")[0]] = [name for row in rows for name in re.findall(r"`([^`]+)`", row)]
    of_background = listed["Results of `rsmcm background`"]
    assert of_background[: len(COLUMNS)] == list(COLUMNS)
    for folder, names in (
        ("street", of_background[len(COLUMNS) :]),
        ("shape", set(listed["Results of `rsmcm structure`"]) - {"colmap/"}),  # of a perspective camera
    ):
        assert [name for name in names if not (Path("results") / folder / name).exists()] == []
    with np.load("results/body/poses.npz") as poses:
        assert set(poses.files) <= set(listed["Results of `rsmcm body` and `rsmcm face`"])
    found = reader.names
    assert len(found["table"]) == len(found["same"]) > 0
    assert sum(found["inside"]) > 0
    assert np.isfinite(found["live"].data["covariance"]).all()
    assert found["drawn"].any()
    assert found["mask"].sum() == found["annotation"]["area"] > 0
    assert found["left_hand"].shape == (8, 2)
    assert set(found["older"].sizes) == {"time", "space", "keypoints", "individuals"}
    assert found["points"].shape == (5, 8, 2)
    n_frames = len(list(Path("colmap").iterdir()))
    assert Path("matches.txt").read_text().count("\n\n") == n_frames * (n_frames - 1) / 2


def check_tutorial(reader: Reader) -> None:
    """The tracker keeps who stands, and the window's chain keeps the background closed."""
    names = reader.names
    assert names["f_score"](names["masks"]) > names["f_score"](names["masks_alone"]) + 0.2
    top, left, height, width = names["region"]
    closed = names["frames"][290].image.astype(float)
    off = [abs(beliefs[290]["background"].picture() - closed) for beliefs in names["runs"]]
    alone, explained = (each[top : top + height, left : left + width].mean() for each in off)
    assert alone > 5 * explained  # 77 and 5 grey levels


def check_recipes(reader: Reader) -> None:
    names, seconds = reader.names, 24 / 25
    found = names["detector"](names["frame"])
    assert found.shape == (1, 5)  # of two, the person
    assert names["counts"]["film.mp4"] > 0
    assert 0 <= names["by_object"].seconds.max() <= seconds
    assert Path("drawn.mp4").stat().st_size > 0
    assert cv2.imread("heat.png").shape == (240, 320, 3)
    assert all(
        cv2.imread(str(path), cv2.IMREAD_UNCHANGED).shape[2] == 4 for path in Path().glob("person-*.png")
    )
    assert names["rows"].execute("select count(*) from boxes").fetchone()[0] > 0
    assert len(loadmat("street.mat")["tracks"]["frame"][0, 0].ravel()) == len(names["columns"]["frame"])
    colmap = np.load("from-colmap.npz")["tracks"]
    np.testing.assert_array_equal(colmap, [[[1, 2], [5, 6]], [[3, 4], [np.nan, np.nan]]])
    marked = np.load("deeplabcut.npz")["tracks"]
    np.testing.assert_array_equal(marked, [[[1, 2], [3, 4]], [[5, 6], [np.nan, np.nan]]])


def test_recipes_are_short() -> None:
    recipes = PAGES["recipes"].read_text().split("\n## ")[1:]
    assert len(recipes) >= 20
    path = PAGES["recipes"]
    assert max(len(block.text.splitlines()) for block in blocks(path)) <= 15


def check_scale(reader: Reader) -> None:
    for folder in ("films", "cameras"):
        with Path("results", folder, "summary.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert [(row["folder"], row["state"]) for row in rows] == [("gate", "complete"), ("yard", "complete")]
        assert ", ".join(rows[0]) in PAGES["scale"].read_text()


CHECKS: dict[str, Callable[[Reader], None]] = {
    "background": check_background,
    "structure": lambda reader: result_files("structure", "shape"),
    "faces": lambda reader: result_files("faces", "face"),
    "bodies": check_bodies,
    "python": check_python,
    "recipes": check_recipes,
    "scale": check_scale,
    "tutorial": check_tutorial,
    "files": check_files,
}
