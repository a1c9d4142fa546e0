"""Libraries of linear algebra have one thread in every command, unless the user has set it."""

import os
import subprocess
import sys

import pytest
from rsmcm.apps.options.library_threads import OF_LIBRARIES, OF_OPENCV, have_one_thread, thread_limits

NAMES = [*(f"{library}_NUM_THREADS" for library in OF_LIBRARIES), OF_OPENCV]


def test_what_the_user_has_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    have_one_thread()
    assert [os.environ[name] for name in NAMES] == ["1", "3", "1", "1", "1", "1", "1"]
    assert thread_limits(2) == {**dict.fromkeys(NAMES, "2"), OF_OPENCV: "1"}


def test_opencv_heeds_its_variable() -> None:
    script = (
        "from rsmcm.apps.options.library_threads import have_one_thread; have_one_thread()\n"
        "import cv2; print(cv2.getNumThreads())"
    )
    environment = {name: value for name, value in os.environ.items() if name != OF_OPENCV}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert done.stdout == "1\n"


def test_libraries_are_loaded_after_that() -> None:
    """Otherwise they would have read the variables before they are set."""
    script = (
        "import sys, rsmcm.apps.command_line as line\n"
        "line.have_one_thread = lambda: print({'numpy', 'cv2'} & {*sys.modules})\n"
        "line.main(['background', 'nothing.mp4', '--out', 'nowhere'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "set()\n")
