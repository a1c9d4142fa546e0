"""The second process begins with the first loop that is compiled, and ends with the run."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest
from rsmcm.apps.first_use import ahead
from rsmcm.models.numerics.threads import set_threads, thread_count


class Process:
    """What `Popen` gives."""

    started: list[list[str]]
    ended: int

    def __init__(self, command: list[str], **_: Any) -> None:
        self.started.append(command)

    def terminate(self) -> None:
        type(self).ended += 1

    def wait(self) -> None:
        pass


@pytest.mark.parametrize(("threads", "processes"), [(2, 1), (1, 0)])
def test_it_begins_once_and_ends(threads: int, processes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    before = thread_count()
    Process.started, Process.ended = [], 0
    monkeypatch.setattr(subprocess, "Popen", Process)
    try:
        set_threads(threads)
        with ahead.compiling_ahead("background"):
            assert Process.started == []
            for number in range(2):
                assert numba.njit(lambda x, number=number: x + number)(1) == 1 + number
        assert [command[-1] for command in Process.started] == ["background"] * processes
        assert Process.ended == processes
        numba.njit(lambda x: x)(1)
        assert len(Process.started) == processes
    finally:
        set_threads(before)


def test_what_the_list_has_in_vain_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def compiled(name: str, *_: Any) -> None:
        done.append(name)
        if name == "gone":
            raise ImportError(name)

    monkeypatch.setattr(ahead, "listed", lambda application: [["first"], ["gone"], ["last"]])
    monkeypatch.setattr(ahead, "compile_loop", compiled)
    ahead.main("background")
    assert done == ["last", "gone", "first"]


def test_nobody_is_worked_for_who_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    parents, done = iter([5, 5, 1, 1]), []
    monkeypatch.setattr(ahead.os, "getppid", lambda: next(parents))
    monkeypatch.setattr(ahead, "listed", lambda application: [["first"], ["middle"], ["last"]])
    monkeypatch.setattr(ahead, "compile_loop", lambda name: done.append(name))
    ahead.main("background")
    assert done == ["last"]


def test_both_processes_find_each_others_loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that one process has compiled is not compiled again in another one."""
    script = (
        "import numba.core.event as event, rsmcm.apps.first_use.kernels as kernels\n"
        "with event.install_recorder('numba:compile') as found:\n"
        "    kernels.compile_loop('models.pixels.colour:_planes_of_colour', 'array(uint8, 1d, C)',"
        " 'array(float32, 2d, C)')\n"
        "print(len(found.buffer))"
    )
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    counts = []
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
        counts.append(int(done.stdout))
    assert counts[0] > 0
    assert counts[1] == 0
