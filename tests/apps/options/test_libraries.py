"""Libraries of linear algebra have one thread in every command, unless the user has set it."""

import os
import subprocess
import sys
import zlib
from importlib import metadata
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.options.libraries import (
    EXPECTED,
    OF_LIBRARIES,
    OF_OPENCV,
    have_one_thread,
    opencv_hint,
    quiet_libraries,
    thread_limits,
)
from rsmcm.models.face.detectors import HaarFaces

NAMES = [*(f"{library}_NUM_THREADS" for library in OF_LIBRARIES), OF_OPENCV]


def test_what_the_user_has_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    have_one_thread()
    assert [os.environ[name] for name in NAMES] == ["1", "3", "1", "1", "1", "1", "1"]
    assert thread_limits(2) == {**dict.fromkeys(NAMES, "2"), OF_OPENCV: "1"}


HINT = (
    f" (cv2 comes from opencv-python and {EXPECTED}, expected {EXPECTED} alone: uninstall all, install that)"
)


@pytest.fixture
def intruder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which lies what pip notes of an installed package."""
    folder = tmp_path / "opencv_python-5.0.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: opencv-python\nVersion: 5.0.0\n")
    (folder / "top_level.txt").write_text("cv2\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def lacking() -> Exception:
    """What comes of a function that OpenCV does not have."""
    with pytest.raises(AttributeError) as caught:
        cv2.utils.nothing  # type: ignore[attr-defined]  # noqa: B018
    return caught.value


def test_this_installation_is_as_expected() -> None:
    assert set(metadata.packages_distributions()["cv2"]) == {EXPECTED}
    assert opencv_hint(lacking()) == ""


def test_errors_of_opencv(intruder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert opencv_hint(lacking()) == HINT
    with pytest.raises(ImportError) as missing:
        from cv2 import nothing  # type: ignore[attr-defined]  # noqa: F401
    assert opencv_hint(missing.value) == HINT
    monkeypatch.setattr(cv2, "__file__", str(intruder / "cv2" / "__init__.py"))
    with pytest.raises(ValueError, match="has no face detector") as cascade:
        HaarFaces()
    assert opencv_hint(cascade.value) == HINT


def test_opencv_that_cannot_be_imported(intruder: Path, tmp_path: Path) -> None:
    """As where a library of the system is missing that the windows need."""
    (intruder / "cv2.py").write_text("raise ImportError('libGL.so.1: cannot open', name='cv2')\n")
    run = (
        f"import sys; sys.path.insert(0, {str(intruder)!r}); from rsmcm.apps.command_line import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", run, "background", "0", "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (2, f"rsmcm: libGL.so.1: cannot open{HINT}\n")


def damaged_png() -> bytes:
    """A line filter that is none, under a correct check sum."""
    done = bytearray(cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1])
    at = done.index(b"IDAT")
    length = int.from_bytes(done[at - 4 : at], "big")
    lines = bytearray(zlib.decompress(done[at + 4 : at + 4 + length]))
    lines[9] = 77
    packed = b"IDAT" + zlib.compress(lines)
    check_sum = zlib.crc32(packed).to_bytes(4, "big")
    return bytes(done[: at - 4]) + (len(packed) - 4).to_bytes(4, "big") + packed + check_sum + done[-12:]


def test_decoders_are_silent(capfd: pytest.CaptureFixture[str]) -> None:
    content = np.frombuffer(damaged_png(), np.uint8)
    with quiet_libraries():
        cv2.imdecode(content, cv2.IMREAD_COLOR)
        os.write(2, b"of a library\n")
    os.write(2, b"ours\n")
    assert capfd.readouterr().err == "ours\n"
