"""Work in several processes: results in order, one thread each, errors as they are."""

import math
import os
from collections.abc import Callable
from typing import Any

import pytest
from rsmcm.apps.runs.parallel import in_parallel
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
