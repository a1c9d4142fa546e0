"""Public sequences: which folder wins, and what a machine without network is told."""

from pathlib import Path

import pytest
import requests
from rsmcm.apps.experiments import datasets


@pytest.fixture(autouse=True)
def _nothing_at_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No folder has anything, and there is no network."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.delenv(datasets.VARIABLE, raising=False)
    monkeypatch.setattr(datasets, "__file__", str(tmp_path / "a" / "b" / "c" / "d" / "datasets.py"))
    monkeypatch.setattr(datasets.pooch, "os_cache", lambda name: tmp_path / "cache" / name)

    def unreachable(*arguments: object, **settings: object) -> str:
        raise requests.exceptions.ConnectionError("a very long\nstory")

    monkeypatch.setattr(datasets.pooch, "retrieve", unreachable)


def pets(folder: Path) -> Path:
    folder = folder / "pets2009-s2l1"
    folder.mkdir(parents=True)
    (folder / "vtest.avi").touch()
    (folder / "gt.txt").touch()
    return folder


def test_named_folder_wins_over_the_one_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beside = pets(tmp_path / "shared" / "data")
    assert datasets.data_folder("pets2009-s2l1").resolve() == beside
    named = pets(tmp_path / "named")
    monkeypatch.setenv(datasets.VARIABLE, str(tmp_path / "named"))
    assert datasets.data_folder("pets2009-s2l1") == named


def test_without_network_one_line_says_what_to_put_where() -> None:
    for name, (files, address) in datasets.SEQUENCES.items():
        with pytest.raises(FileNotFoundError) as caught:
            datasets.data_folder(name)
        message = str(caught.value)
        assert "\n" not in message
        assert message.startswith(name)
        assert all(part in message for part in (datasets.VARIABLE, address, *files))
    with pytest.raises(ValueError, match=r"'pets'.*pets2009-s2l1"):
        datasets.data_folder("pets")


def test_fetched_boxes_are_converted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def retrieve(url: str, known_hash: str | None, fname: str, path: Path) -> str:
        path.mkdir(parents=True, exist_ok=True)
        (path / fname).write_text(annotation(795, 19, 4650))
        return str(path / fname)

    monkeypatch.setattr(datasets.pooch, "retrieve", retrieve)
    folder = datasets.data_folder("pets2009-s2l1")
    assert folder == tmp_path / "cache" / "rsmcm" / "pets2009-s2l1"
    lines = (folder / "gt.txt").read_text().splitlines()
    assert lines[0] == "1,1,499.20,157.70,31.00,75.00,1,-1,-1,-1"
    assert len(lines) == 4650
    assert lines[-1].startswith("795,")


@pytest.mark.parametrize("text", ["404: not found", "<dataset><frame/></dataset>", "<dataset/>"])
def test_something_else_instead_of_boxes_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="annotation"):
        datasets.mot_from_cvml(text, frames=1, identities=1, boxes=1)


def annotation(frames: int, identities: int, boxes: int) -> str:
    """A CVML annotation whose frames count from 0."""
    objects: list[list[str]] = [[] for _ in range(frames)]
    for number in range(boxes):
        box = '<box h="75" w="31" xc="514.7" yc="195.2"/>'
        objects[number * frames // boxes].append(f'<object id="{1 + number % identities}">{box}</object>')
    inside = (
        f'<frame number="{number}"><objectlist>{"".join(here)}</objectlist></frame>'
        for number, here in enumerate(objects)
    )
    return f'<?xml version="1.0"?><dataset name="x">{"".join(inside)}</dataset>'
