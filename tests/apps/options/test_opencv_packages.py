"""Other packages of OpenCV are named where they have led to an error, and only there."""

import subprocess
import sys
from importlib import metadata
from pathlib import Path

import cv2
import pytest
from rsmcm.apps.command_line import main
from rsmcm.apps.options.opencv_packages import EXPECTED, opencv_hint
from rsmcm.models.face.detectors import HaarFaces

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
    with pytest.raises(ValueError, match="brings no face detector along") as cascade:
        HaarFaces()
    assert opencv_hint(cascade.value) == HINT


def test_other_errors(intruder: Path) -> None:
    for error in (ValueError("cv2"), ImportError(name="scipy"), AttributeError("cv2", obj=intruder)):
        assert opencv_hint(error) == ""


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


def test_other_missing_modules_are_not_hidden(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def missing(_: object) -> None:
        raise ModuleNotFoundError("No module named 'scipy'", name="scipy")

    monkeypatch.setattr("rsmcm.apps.background.application.run_background", missing)
    with pytest.raises(ModuleNotFoundError):
        main(["background", "0", "--out", str(tmp_path / "out")])
