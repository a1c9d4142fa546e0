"""Threads of the loops over pixels, and what becomes of them in a forked process."""

import multiprocessing
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest
from rsmcm.models.numerics.threads import Background, over_bands, set_threads, side_by_side, thread_count

needs_fork = pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="the system has no fork"
)

SECONDS = 60  # a process that takes longer hangs


@pytest.fixture(autouse=True)
def threads() -> Iterator[None]:
    before = thread_count()
    yield
    set_threads(before)


@pytest.mark.parametrize(("count", "n_rows"), [(1, 7), (3, 2), (3, 100), (8, 7)])
def test_bands_cover_all_rows_once(count: int, n_rows: int) -> None:
    opencv = cv2.getNumThreads()
    set_threads(count)
    assert (thread_count(), cv2.getNumThreads()) == (count, opencv)  # which has its own
    visits = np.zeros(n_rows, int)

    def work(first: int, end: int) -> None:
        assert first < end
        visits[first:end] += 1

    over_bands(work, n_rows)
    assert (visits == 1).all()
    with pytest.raises(ValueError, match=r"threads: got 0, expected 1 or more"):
        set_threads(0)


@pytest.mark.parametrize("costs", [[1, 1, 1, 1, 6, 2], [12, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 9]])
def test_bands_cost_the_same_as_far_as_rows_can(costs: list[int]) -> None:
    set_threads(2)
    bands = list[tuple[int, int]]()
    over_bands(lambda first, end: bands.append((first, end)), len(costs), costs=np.array(costs))
    bands.sort()
    assert bands[0][0] == 0
    assert bands[-1][1] == len(costs)
    assert all(first < end for first, end in bands)
    assert [end for _, end in bands[:-1]] == [first for first, _ in bands[1:]]
    dearest = max(sum(costs[first:end]) for first, end in bands)
    assert dearest <= sum(costs) / 2 + max(costs)


@pytest.mark.parametrize("count", [1, 3])
def test_results_are_in_the_order_of_the_work(count: int) -> None:
    set_threads(count)

    def shared(size: int) -> int:
        return sum(side_by_side([partial(pow, k, 2) for k in range(size)]))

    expected = [sum(k * k for k in range(size)) for size in range(1, 20)]
    for _ in range(5):
        assert side_by_side([partial(shared, size) for size in range(1, 20)]) == expected


@pytest.mark.parametrize("count", [1, 2])
def test_what_one_piece_raises_comes_out(count: int) -> None:
    set_threads(count)
    ended = []

    def work(number: int) -> None:
        if number == 2:
            raise ValueError("two")
        ended.append(number)

    with pytest.raises(ValueError, match="two"):
        side_by_side([partial(work, number) for number in range(4)])
    assert {0, 1} <= set(ended)


@pytest.mark.parametrize("threads", [1, 2])
def test_work_in_the_background_is_done_in_order(threads: int) -> None:
    set_threads(threads)
    background, done = Background(), []
    begun = [background.begin(partial(done.append, number)) for number in range(20)]
    assert [each.result() for each in begun] == [None] * 20
    assert done == list(range(20))


def test_an_error_in_the_background_is_raised_for_its_result() -> None:
    set_threads(2)
    begun = Background().begin(partial(int, "one"))
    with pytest.raises(ValueError, match="one"):
        begun.result()


def in_forked_processes(work: Callable[[Any], Any], arguments: list[Any]) -> list[Any]:
    """What `work` gives in two processes that are forked from this one."""
    with multiprocessing.get_context("fork").Pool(2) as pool:
        return pool.map_async(work, arguments).get(SECONDS)


def blurred_squares(size: int) -> float:
    """A sum by our threads, of pictures by those of OpenCV."""
    pictures = side_by_side([partial(np.full, (64, 64), k * k, np.float64) for k in range(size)])
    return float(sum(cv2.blur(picture, (5, 5))[0, 0] for picture in pictures))


@needs_fork
def test_threads_that_were_used_work_in_forked_processes() -> None:
    set_threads(2)
    expected = blurred_squares(12)
    assert expected == pytest.approx(sum(k * k for k in range(12)))
    assert in_forked_processes(blurred_squares, [12] * 4) == [expected] * 4
