"""Drawings of the graph."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from ...support.discrete import random_model

LINKS = [("background", "pixels"), ("blobs", "pixels"), ("blobs", "objects"), ("ground", "objects")]


@pytest.mark.parametrize("suffix", [".svg", ".png"])
def test_a_drawing_is_a_picture_of_its_suffix(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"graph{suffix}"
    random_model(np.random.default_rng(0), LINKS).draw(path)
    if suffix == ".svg":
        assert ElementTree.parse(path).getroot().tag.endswith("svg")
    else:
        assert path.read_bytes().startswith(b"\x89PNG")


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"graph.txt.*\.svg or \.png"):
        random_model(np.random.default_rng(0), LINKS).draw(tmp_path / "graph.txt")
    assert not list(tmp_path.iterdir())
