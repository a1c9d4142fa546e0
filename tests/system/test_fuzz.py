"""The fuzzer: its seeds are sound, and a small run of it finds no fault."""

from pathlib import Path

import pytest

from ..fuzz.readers import FORGED, READERS
from ..fuzz.seeds import made
from ..fuzz.workers import REFUSED, RESULT, Seeds, input_of, outcomes, write


@pytest.fixture(scope="module")
def seeds() -> Seeds:
    """Of readers of files, which are made in no time."""
    return made(READERS.keys() - FORGED)


@pytest.fixture(scope="module")
def states() -> Seeds:
    """Of runs."""
    return made(FORGED)


def test_seeds_are_sound(seeds: Seeds, tmp_path: Path) -> None:
    require_sound(seeds, tmp_path)


@pytest.mark.slow
def test_states_are_sound(states: Seeds, tmp_path: Path) -> None:
    require_sound(states, tmp_path)


def require_sound(seeds: Seeds, tmp_path: Path) -> None:
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
def test_a_small_run(seeds: Seeds, states: Seeds) -> None:
    tasks = [(reader, number) for number in range(40) for reader in READERS]
    found = dict(outcomes(seeds | states, tasks, seed=1))
    assert found.keys() == set(tasks)
    assert {task: outcome for task, outcome in found.items() if outcome not in (RESULT, REFUSED)} == {}
    assert {RESULT, REFUSED} <= set(found.values())
