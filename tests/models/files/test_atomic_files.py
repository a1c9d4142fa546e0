"""Files are whole or as before."""

from pathlib import Path

import pytest
from rsmcm.models.files.atomic_files import write_atomically, write_text

from ...support.film import names


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
