"""Pictures and JSON are whole, and strict."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.io import files
from rsmcm.apps.io.files import MaskWriter

from ...support.film import mask, names


def test_full_disk_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"No space left on device: .*a\.png") as caught:
        files.write_image(tmp_path / "a.png", mask(1))
    assert caught.value.errno == errno.ENOSPC
    with MaskWriter(tmp_path, "png", 10) as writer:
        writer.write(mask(1), 1, 0.0)
        with pytest.raises(OSError, match=r"No space left on device: .*bin000001\.png"):
            writer.checkpoint()
        monkeypatch.undo()
        writer._worker._jobs.clear()  # type: ignore[union-attr]
    assert names(tmp_path) == set()


def test_json_is_strict(tmp_path: Path) -> None:
    content = {
        "f": np.float64(0.5),
        "n": np.int64(3),
        "bad": [float("nan"), np.inf],
        "a": np.arange(2),
        5: tmp_path,
    }
    files.write_json(tmp_path / "a.json", content)
    expected = {"f": 0.5, "n": 3, "bad": [None, None], "a": [0, 1], "5": str(tmp_path)}
    assert json.loads((tmp_path / "a.json").read_text()) == expected
