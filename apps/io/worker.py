"""A thread that writes files, while the run goes on."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class Worker:
    """A thread that does jobs in order; what goes wrong there is raised at a later call here.

    Parameters
    ----------
    name
        of the thread.
    waiting
        jobs that may wait, before `submit` does.
    """

    def __init__(self, name: str, waiting: int = 8) -> None:
        self._thread = ThreadPoolExecutor(1, name)
        self._waiting = waiting
        self._jobs: deque[Future[None]] = deque()

    def submit(self, job: Callable[..., None], *arguments: Any) -> None:
        """Have a function called with these arguments."""
        self._finish(but=self._waiting)
        self._jobs.append(self._thread.submit(job, *arguments))

    def wait(self) -> None:
        """Return when everything is done."""
        self._finish(but=0)

    def stop(self) -> None:
        """Finish everything, unless something has gone wrong, and end the thread."""
        try:
            self.wait()
        finally:
            self._thread.shutdown(cancel_futures=True)

    def _finish(self, but: int) -> None:
        while len(self._jobs) > but:
            self._jobs[0].result()  # stays there if it has gone wrong: nothing is done after it
            self._jobs.popleft()
