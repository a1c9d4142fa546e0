"""Libraries of linear algebra have one thread in every command, whatever the user has set."""

import os
from importlib import metadata
from pathlib import Path

import cv2
import pytest
from rsmcm.apps.options.libraries import (
    EXPECTED,
    ONE_THREAD_EACH,
    have_one_thread,
    opencv_hint,
    quiet_libraries,
)
from rsmcm.models.face.detectors import HaarFaces


def test_one_thread_whatever_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ONE_THREAD_EACH:
        monkeypatch.setenv(name, "3")
    have_one_thread()
    assert {os.environ[name] for name in ONE_THREAD_EACH} == {"1"}


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


def test_decoders_are_silent(capfd: pytest.CaptureFixture[str]) -> None:
    with quiet_libraries():
        os.write(2, b"of a library\n")
    os.write(2, b"ours\n")
    assert capfd.readouterr().err == "ours\n"
