"""Compiled code that processes share, and that follows what it was made from."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from numba.core.caching import FunctionCache
from rsmcm.models.numerics.compiled import _warn, cache_folder

PROGRAM = """
from numba.core import event
import numpy as np
from rsmcm.models.numerics.compiled import put

class Compiled(event.Listener):
    names = []
    def on_start(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass

with event.install_listener("numba:compile", Compiled()):
    place = np.empty(3)
    put(np.arange(3.0), place)
print("put" in Compiled.names, place.tobytes().hex())
"""


def run(folder: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM], env=environment, stdout=subprocess.PIPE, text=True
    )


def test_processes_at_once_and_later_ones_have_the_same_code(tmp_path: Path) -> None:
    both = [run(tmp_path) for _ in range(2)]
    results = [process.communicate(timeout=120)[0].split()[1] for process in both]
    is_compiled, result = run(tmp_path).communicate(timeout=120)[0].split()
    assert is_compiled == "False"
    assert {*results} == {result}


CALLED = """
from rsmcm.models.numerics.compiled import compiled, inlined
from .constants import STEP

@inlined
def smaller(x):
    return x - STEP
"""

CALLER = """
from rsmcm.models.numerics.compiled import compiled
from .called import smaller

@compiled
def twice(x):
    return 2.0 * smaller(x)
"""


@pytest.fixture
def twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return `caller.twice` of a package with a given constant, as a new process imports it."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    package = tmp_path / "scratch_package"
    package.mkdir()
    for name, text in {"__init__": "", "called": CALLED, "caller": CALLER}.items():
        (package / f"{name}.py").write_text(text)

    def imported(step: float):
        (package / "constants.py").write_text(f"STEP = {step}")
        for name in [name for name in sys.modules if name.startswith("scratch_package")]:
            del sys.modules[name]
        importlib.invalidate_caches()
        cache_folder.cache_clear()
        return importlib.import_module("scratch_package.caller").twice

    yield imported
    cache_folder.cache_clear()
    _warn.cache_clear()


def test_code_is_kept_until_a_constant_in_another_module_changes(twice) -> None:
    assert twice(0.25)(1.0) == 1.5
    kept = twice(0.25)
    assert kept(1.0) == 1.5
    assert sum(kept.stats.cache_hits.values()) == 1
    changed = twice(0.5)
    assert changed(1.0) == 1.0
    assert sum(changed.stats.cache_misses.values()) == 1
    beside = Path(changed.py_func.__code__.co_filename).parent / "__pycache__"
    assert len([*beside.glob("caller-*")]) == 1  # the folder of the earlier state is removed


def test_where_no_folder_can_be_written_to_code_is_compiled_each_time_and_that_is_said_once(
    twice, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    for _ in range(2):
        function = twice(0.25)
        assert function(1.0) == 1.5
        assert not function.stats.cache_hits
    (said,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in said


def test_code_that_was_kept_before_is_used_where_nothing_can_be_written(
    twice, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    filled = twice(0.25)
    assert filled(1.0) == 1.5
    source = Path(filled.py_func.__code__.co_filename)
    os.utime(source, (1e9, 1e9))  # as a layer of a container may have it
    monkeypatch.setattr(os, "access", lambda *_: False)
    kept = twice(0.25)
    assert kept(1.0) == 1.5
    assert sum(kept.stats.cache_hits.values()) == 1
    assert caplog.messages == []


def test_a_user_without_a_home_gets_no_folder_of_that_name(
    twice, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.chdir(tmp_path)
    assert twice(0.25)(1.0) == 1.5
    assert not Path("~").exists()


def test_a_full_disk_does_not_end_the_run(
    twice, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FunctionCache, "save_overload", refuse)
    assert twice(0.25)(1.0) == 1.5
    assert "cannot be kept" in caplog.text
