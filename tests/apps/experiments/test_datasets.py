"""Public sequences: which folder wins, and what is said where none has them."""

from pathlib import Path

import pytest
from rsmcm.apps.experiments import datasets


@pytest.fixture(autouse=True)
def _nothing_at_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No folder has anything."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.delenv(datasets.VARIABLE, raising=False)
    monkeypatch.setattr(datasets, "__file__", str(tmp_path / "a" / "b" / "c" / "d" / "datasets.py"))


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


def test_one_line_says_what_to_put_where() -> None:
    for name, (files, address) in datasets.SEQUENCES.items():
        with pytest.raises(FileNotFoundError) as caught:
            datasets.data_folder(name)
        message = str(caught.value)
        assert "\n" not in message
        assert message.startswith(name)
        assert all(part in message for part in (datasets.VARIABLE, address, *files))
    with pytest.raises(ValueError, match=r"'pets'.*pets2009-s2l1"):
        datasets.data_folder("pets")
