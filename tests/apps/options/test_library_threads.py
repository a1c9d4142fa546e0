"""Libraries of linear algebra have one thread in every command, unless the user has set it."""

import os
import subprocess
import sys

import pytest
from rsmcm.apps.options.library_threads import OF_LIBRARIES, have_one_thread, thread_limits

NAMES = [f"{library}_NUM_THREADS" for library in OF_LIBRARIES]


def test_what_the_user_has_set_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    have_one_thread()
    assert [os.environ[name] for name in NAMES] == ["1", "3", "1", "1", "1", "1"]
    assert thread_limits(2) == dict.fromkeys(NAMES, "2")


def test_numpy_is_loaded_after_that() -> None:
    """Otherwise it would have read the variables before they are set."""
    script = (
        "import sys, rsmcm.apps.command_line as line\n"
        "line.have_one_thread = lambda: print('numpy' in sys.modules)\n"
        "line.main(['background', 'nothing.mp4', '--out', 'nowhere'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "False\n")
