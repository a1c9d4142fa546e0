"""Work in several processes: results in order, one thread each, errors as they are."""

import math
import os
from collections.abc import Callable
from typing import Any

import pytest
from rsmcm.apps.runs.parallel import in_parallel, whatever_fails
from rsmcm.models.numerics.threads import thread_count

Task = tuple[Callable[..., Any], tuple[Any, ...]]


def test_results_in_order_from_other_processes_of_one_thread() -> None:
    roots: list[Task] = [(math.sqrt, (number**2,)) for number in range(5)]
    *found, process, threads = in_parallel("test", [*roots, (os.getpid, ()), (thread_count, ())])
    assert found == list(range(5))
    assert process != os.getpid()
    assert threads == 1


def test_an_error_is_that_of_the_function() -> None:
    with pytest.raises(ValueError, match="domain"):
        in_parallel("test", [(math.sqrt, (1.0,)), (math.sqrt, (-1.0,))])


def test_neither_an_error_nor_a_dead_process_stops_the_others() -> None:
    work: dict[str, Task] = {f"{number}": (math.sqrt, (number**2,)) for number in range(4)}
    work |= {"wrong": (math.sqrt, (-1.0,)), "dies": (os._exit, (3,)), "last": (math.sqrt, (25.0,))}
    found = dict(whatever_fails("test", work, "tasks"))
    assert found.keys() == work.keys()
    wrong, dies = found.pop("wrong"), found.pop("dies")
    assert isinstance(wrong, ValueError)
    assert isinstance(dies, ChildProcessError)
    assert str(dies) == "its process was ended by the system, twice"
    assert found == {"0": 0, "1": 1, "2": 2, "3": 3, "last": 5}
    assert list(whatever_fails("test", work, "tasks", stopping=lambda: True)) == []
