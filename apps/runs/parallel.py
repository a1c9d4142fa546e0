"""Experiments on several sequences at once, each in a process of one thread."""

from collections.abc import Callable, Sequence
from typing import Any

from joblib import Parallel, cpu_count, delayed, parallel_config

from ...models.numerics.threads import set_threads
from .progress import Progress

MOST_WORKERS = 2


def in_processes(label: str, work: Sequence[tuple[Callable[..., Any], tuple[Any, ...]]]) -> list[Any]:
    """Results of functions with their arguments, in order, worked out in two processes at most."""
    found: dict[int, Any] = {}
    tasks = (delayed(_alone)(number, *task) for number, task in enumerate(work))
    workers = min(MOST_WORKERS, cpu_count())
    with (
        parallel_config("loky", n_jobs=workers, inner_max_num_threads=1),  # linear algebra's threads
        Progress(label, len(work), unit="sequences") as progress,
    ):
        for number, result in Parallel(return_as="generator_unordered")(tasks):
            found[number] = result
            progress.update()
    return [found[number] for number in range(len(work))]


def _alone(number: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    set_threads(1)  # of our own loops
    return number, function(*arguments)
