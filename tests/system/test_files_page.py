"""The page on files: what it shows runs as printed, and the files and columns that it names are there."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.background.demo import SIGNER, write_body, write_cylinder, write_scene
from rsmcm.apps.command_line import main
from rsmcm.apps.exports.track_table import COLUMNS
from rsmcm.apps.scenes import signer, sleeping_man

PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text()


def rows(heading: str) -> Iterator[tuple[str, ...]]:
    """Names in backticks in the first column of the tables below a heading, up to the next one."""
    text = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    for first in re.findall(r"^\| (`[^|]+) \|", text, re.MULTILINE):
        yield tuple(re.findall(r"`([^`]+)`", first))


def test_it_can_be_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(sleeping_man(24, enter=0), Path("results/demo/scene"))
    write_cylinder(Path("results/demo/cylinder.npz"))
    write_body(signer(8, SIGNER), Path("results/demo/body"))
    names: dict[str, Any] = {"__name__": "files"}
    for language, block in re.findall(r"```(sh|python)\n(.*?)```", PAGE, re.DOTALL):
        if language == "python":
            exec(compile(block, "files.md", "exec"), names)
            continue
        for line in block.splitlines():
            with pytest.raises(SystemExit) as ended:
                main(shlex.split(line)[1:])
            assert ended.value.code == 0, line
    assert len(names["table"]) == len(names["same"]) > 0
    assert sum(names["inside"]) > 0
    assert np.isfinite(names["live"].data["covariance"]).all()
    assert names["drawn"].any()
    assert names["mask"].sum() == names["annotation"]["area"] > 0
    assert names["left_hand"].shape == (8, 2)
    assert set(names["older"].sizes) == {"time", "space", "keypoints", "individuals"}
    assert names["points"].shape == (5, 8, 2)
    pairs = Path("matches.txt").read_text().split("\n\n")
    n_frames = len(list(Path("colmap").iterdir()))
    assert len(pairs) - 1 == n_frames * (n_frames - 1) / 2
    for folder, heading in (
        ("street", "Results of `rsmcm background`"),
        ("shape", "Results of `rsmcm structure`"),
    ):
        for name, *_ in rows(heading):
            assert name in COLUMNS or (Path("results") / folder / name).exists(), name
    with np.load("results/body/poses.npz") as poses:
        listed = [name for row in rows("Results of `rsmcm body` and `rsmcm face`") for name in row]
        assert set(poses.files) <= set(listed)


def test_all_columns_of_the_table_are_explained_in_order() -> None:
    listed = [name for row in rows("Results of `rsmcm background`") for name in row]
    assert listed[: len(COLUMNS)] == list(COLUMNS)
