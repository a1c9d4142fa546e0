"""A thread that writes files, while the run goes on."""

import queue
import threading
from collections.abc import Callable
from typing import Any


class Worker:
    """A thread that does jobs in order; what goes wrong there is raised at the next call here.

    Parameters
    ----------
    name
        of the thread.
    waiting
        jobs that may wait, before `submit` does.
    """

    def __init__(self, name: str, waiting: int = 8) -> None:
        self._jobs: queue.Queue[tuple[Callable[..., None], tuple[Any, ...]] | None] = queue.Queue(waiting)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def submit(self, job: Callable[..., None], *arguments: Any) -> None:
        """Have a function called with these arguments."""
        self._raise()
        self._jobs.put((job, arguments))

    def wait(self) -> None:
        """Return when everything is done."""
        self._jobs.join()
        self._raise()

    def stop(self) -> None:
        """Finish everything and end the thread."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()
        self._raise()

    def _work(self) -> None:
        while (item := self._jobs.get()) is not None:
            job, arguments = item
            try:
                if self._error is None:
                    job(*arguments)
            except BaseException as error:  # handed over to the thread that submits
                self._error = error
            finally:
                self._jobs.task_done()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error
