"""The second process begins with the first loop that is compiled, and ends with the run."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba import types
from rsmcm.apps.runs import first_use
from rsmcm.apps.runs.first_use import LIST, compile_loop, plain, type_of
from rsmcm.chains.objects.blob_records import RECORD
from rsmcm.models.numerics.threads import set_threads, thread_count
from rsmcm.models.pixels.colour import _planes_of_colour as loop
from rsmcm.models.pixels.layers import LAYER


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
        with first_use.compiling_ahead("background"):
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

    monkeypatch.setattr(first_use, "listed", lambda application: [["first"], ["gone"], ["last"]])
    monkeypatch.setattr(first_use, "compile_loop", compiled)
    first_use.compile_ahead("background")
    assert done == ["last", "gone", "first"]


def test_nobody_is_worked_for_who_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    parents, done = iter([5, 5, 1, 1]), []
    monkeypatch.setattr(first_use.os, "getppid", lambda: next(parents))
    monkeypatch.setattr(first_use, "listed", lambda application: [["first"], ["middle"], ["last"]])
    monkeypatch.setattr(first_use, "compile_loop", lambda name: done.append(name))
    first_use.compile_ahead("background")
    assert done == ["last"]


def test_both_processes_find_each_others_loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that one process has compiled is not compiled again in another one."""
    script = (
        "import numba.core.event as event, rsmcm.apps.runs.first_use as first_use\n"
        "with event.install_recorder('numba:compile') as found:\n"
        "    first_use.compile_loop('models.pixels.colour:_planes_of_colour', 'array(uint8, 1d, C)',"
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


class Pair(NamedTuple):
    first: np.ndarray
    second: float


class Twins(NamedTuple):
    one: float
    other: float


def read_only() -> np.ndarray:
    values = np.zeros((2, 3), np.float32)
    values.flags.writeable = False
    return values


@pytest.mark.parametrize(
    "value",
    [
        np.zeros(3, np.uint8),
        np.zeros((2, 3), np.float32)[:, 1:],
        np.asfortranarray(np.zeros((2, 3))),
        read_only(),
        1,
        2.0,
        np.float32(2.0),
        np.int16(3),
        True,
        (1, 2.0),
        (1, 2),
        Pair(np.zeros((1, 2, 3)), 1.0),
        np.zeros(2, RECORD),
        np.zeros(2, LAYER)[::2],
        Twins(1.0, 2.0),
    ],
)
def test_a_type_is_what_it_was(value: object) -> None:
    kind = numba.typeof(value)
    assert type_of(json.loads(json.dumps(plain(kind)))) == kind


def test_a_literal_is_what_it_was() -> None:
    assert type_of(plain(types.literal(3))) == types.literal(3)


@pytest.mark.parametrize("kind", [types.unicode_type, types.none, numba.typeof(np.zeros(2, "f4,f4"))])
def test_other_types_are_refused(kind: object) -> None:
    with pytest.raises(TypeError, match="expected an array, a number, or a tuple of these"):
        plain(kind)


def test_the_list_of_one_application_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_use, "LIST", tmp_path / "kernels.json")
    (tmp_path / "kernels.json").write_text("{}")
    for application, name in (("one", "a:b"), ("other", "c:d"), ("one", "e:f")):
        first_use.write_list(application, [[name, "float32", "array(uint8, 1d, C)"]])
    assert first_use.listed("one") == [["e:f", "float32", "array(uint8, 1d, C)"]]
    assert first_use.listed("other") == [["c:d", "float32", "array(uint8, 1d, C)"]]
    assert first_use.listed("third") == []


def test_a_loop_is_found_by_its_name() -> None:
    arguments = (types.Array(types.uint8, 1, "C"), types.Array(types.float32, 2, "C"))
    compile_loop("models.pixels.colour:_planes_of_colour", *map(plain, arguments))
    assert arguments in loop.signatures
    with pytest.raises(AttributeError):
        compile_loop("models.pixels.colour:no_such_loop")
    with pytest.raises(ImportError):
        compile_loop("models.no_such_module:loop")


def test_the_list_is_of_loops_in_the_package() -> None:
    lists = json.loads(LIST.read_text())
    assert "background" in lists
    for loops in lists.values():
        assert all(name.split(".")[0] in ("models", "inference", "chains", "apps") for name, *_ in loops)
