"""Files are whole or as before."""

import json
from pathlib import Path

import pytest
from rsmcm.models.files import write_atomically, write_text

from ..support.film import names


def test_file_is_whole_or_as_before(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_text(path, "before")

    def interrupted() -> None:
        with write_atomically(path) as unfinished:
            unfinished.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "before"
    assert names(tmp_path) == {"summary.json"}


def test_names_of_files_that_are_no_utf_8_are_escaped(tmp_path: Path) -> None:
    name = b"\xff.avi".decode("utf-8", "surrogateescape")
    write_text(tmp_path / "summary.json", f'"{name} é"')
    assert (tmp_path / "summary.json").read_bytes() == '"\\udcff.avi é"'.encode()
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == f"{name} é"
