"""Types of arguments survive the list; what is not there any more is an error of its own."""

import json
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba import types
from rsmcm.apps.first_use.kernels import LIST, compile_loop, listed, named, plain, type_of, write_kernels
from rsmcm.chains.objects.kernels.records import RECORD
from rsmcm.models.pixels.colour import _planes_of_colour as loop
from rsmcm.models.pixels.kernels.layers import LAYER


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


def test_the_list_of_one_application_leaves_the_others(tmp_path: Path) -> None:
    path = tmp_path / "kernels.json"
    for application, name in (("one", "a:b"), ("other", "c:d"), ("one", "e:f")):
        write_kernels(application, [(name, (types.float32, types.Array(types.uint8, 1, "C")))], path)
    assert listed("one", path) == [["e:f", "float32", "array(uint8, 1d, C)"]]
    assert listed("other", path) == [["c:d", "float32", "array(uint8, 1d, C)"]]
    assert listed("third", path) == []


def test_a_loop_is_found_by_its_name() -> None:
    arguments = (types.Array(types.uint8, 1, "C"), types.Array(types.float32, 2, "C"))
    compile_loop(named(loop.py_func), *map(plain, arguments))
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
