"""The fuzzer: its seeds are sound, it sees every kind of fault, and a small run of it finds none."""

import os
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ..fuzz.mutations import Files
from ..fuzz.readers import READERS
from ..fuzz.seeds import made
from ..fuzz.workers import REFUSED, RESULT, Seeds, input_of, outcomes, write


@pytest.fixture(scope="module")
def seeds() -> Seeds:
    return made()


def test_seeds_are_sound(seeds: Seeds, tmp_path: Path) -> None:
    assert seeds.keys() == READERS.keys()
    for reader, inputs in seeds.items():
        for number, files in enumerate(inputs):
            write(files, tmp_path / reader / str(number))
            READERS[reader](tmp_path / reader / str(number))


def test_inputs_are_the_same_again(seeds: Seeds) -> None:
    for reader, inputs in seeds.items():
        again = [input_of(seeds, (reader, number), 3) for number in range(8)]
        assert again == [input_of(seeds, (reader, number), 3) for number in range(8)]
        assert sum(files not in inputs for files in again) >= 6


@pytest.mark.slow
def test_a_small_run(seeds: Seeds) -> None:
    tasks = [(reader, number) for number in range(40) for reader in READERS]
    found = dict(outcomes(seeds, tasks, seed=1))
    assert found.keys() == set(tasks)
    assert {task: outcome for task, outcome in found.items() if outcome not in (RESULT, REFUSED)} == {}
    assert {RESULT, REFUSED} <= set(found.values())


# --- faults that it has to see ------------------------------------------------------------------------------


MOST = 1 << 27  # bytes of memory


def sound(folder: Path) -> None:
    assert folder.is_dir()


def refuses(folder: Path) -> None:
    raise ValueError(f"{folder / 'a'}: no such thing")


def names_nothing(_: Path) -> None:
    raise ValueError("no such thing")


def another_error(_: Path) -> None:
    raise OverflowError("too much")


def dies(_: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def waits(_: Path) -> None:
    time.sleep(60)


def takes_all(_: Path) -> None:
    assert np.ones(MOST >> 2).all()


def asks_for_all(_: Path) -> None:
    np.ones(MOST)


def speaks(_: Path) -> None:
    os.write(2, b"library: something is wrong\n")


def warns(_: Path) -> None:
    warnings.warn("something is wrong", stacklevel=1)


FAULTS: dict[Callable[[Path], None], str] = {
    sound: RESULT,
    refuses: REFUSED,
    names_nothing: "names no file: ValueError",
    another_error: "OverflowError",
    dies: "the process died: SIGSEGV",
    waits: "more than 10 s",
    takes_all: "MiB of memory",
    asks_for_all: "MemoryError",
    speaks: "said by itself: library: something is wrong",
    warns: "said by itself",
}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is bounded and measured on Linux only")
def test_every_fault_is_seen() -> None:
    """And the ones after it are read as if nothing had been."""
    files: list[Files] = [{"a": b"0123456789"}]
    readers = {reader.__name__: reader for reader in FAULTS}
    seeds = dict.fromkeys(readers, files)
    tasks = [*((name, 0) for name in readers), ("sound", 1)]
    found = dict(outcomes(seeds, tasks, readers=readers, n_workers=1, seconds=10, memory=MOST))
    assert found.pop(("sound", 1)) == RESULT
    for reader, words in FAULTS.items():
        assert words in found[reader.__name__, 0]
