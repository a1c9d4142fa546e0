"""A run of an application in its folder of results: what all of them have in common."""

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Generic, TypeVar

from ..first_use.ahead import compiling_ahead
from ..io.segments import segment_pattern
from ..options.job import Job
from ..view.film import FILM, ROWS
from ..view.page import VIEW
from .interruption import Interruption, Outcome
from .output_folder import OutputFolder, output_folder
from .saved_run import STATE, saying_how_to_go_on
from .versions import versions

J = TypeVar("J", bound=Job)

OVERLAY = "overlay.mp4"

_GROWING = (OVERLAY, FILM, ROWS)
ALWAYS = (STATE, "summary.json", VIEW, *_GROWING, *map(segment_pattern, _GROWING))
"""Files that every run may leave."""


class Run(ABC, Generic[J]):
    """One run; an application says what is particular to it.

    Attributes
    ----------
    job
        what it is asked for.
    settings
        what the results depend on, beside the source.
    fingerprint
        by which its source is known again.
    notes
        what is out of the ordinary, a sentence each.
    """

    application: ClassVar[str]

    def __init__(self, job: J) -> None:
        self.job = job
        self.settings = job.settings()
        self.fingerprint: dict[str, Any] = {}
        self.notes: list[str] = []
        self.interruption = Interruption()
        self._folder: OutputFolder
        self._earlier_seconds = 0.0  # of wall time, before the run was resumed
        self._started = time.perf_counter()
        self._is_saved = False
        self._ended_early = False

    @property
    @abstractmethod
    def files(self) -> Sequence[str]:
        """Names of the files that it writes beside `ALWAYS`, patterns of `glob` among them."""

    @abstractmethod
    def in_words(self, summary: Mapping[str, Any]) -> Sequence[str]:
        """A summary in a few lines."""

    @abstractmethod
    def work(self) -> Outcome:
        """Run, in the folder that is locked."""

    def carry_out(self) -> Outcome:
        """Run; all results are in the job's folder afterwards.

        SIGINT (Ctrl-C) and SIGTERM end the run after the current frame or round, with complete results; a
        second one ends it at once, with results up to the last saved state.

        Raises
        ------
        ValueError, OSError
            in one line, whatever is wrong with the job, its files, its source or its output. A film that
            breaks in the middle leaves the results of the frames before.
        Interrupted
            if a signal came before there was any result, or a second one.
        """
        job = self.job
        with (
            saying_how_to_go_on(self.way_on),
            self.interruption,
            output_folder(job.out, self.application, overwrite=job.overwrite, resume=job.resume) as folder,
            compiling_ahead(self.application),
        ):
            self._folder = folder
            return self.work()

    def way_on(self) -> str | None:
        """How the run goes on when it is interrupted; `None` if nothing of it is saved."""
        return f"--resume goes on with {self.job.out}" if self._is_saved else None

    def begin_results(self) -> None:
        """Make the folder ready: not before there is something to write."""
        self._folder.begin([*ALWAYS, *self.files], resume=self.job.resume)

    def about(self, finished: Mapping[str, Any] | None) -> dict[str, Any]:
        """What is said of a saved state; with the summary, if the run is finished."""
        return {
            "application": self.application,
            "settings": self.settings,
            "source": self.fingerprint,
            "seconds": self.seconds(),
            "finished": finished,
        }

    def summary(
        self, source: str, numbers: Sequence[int], missing: Sequence[int], facts: Mapping[str, Any]
    ) -> dict[str, Any]:
        """The content of `summary.json`; `numbers` are those of all frames, of which some are `missing`."""
        return {
            "source": source,
            "frames": len(numbers),
            "first_frame": numbers[0] if numbers else None,
            "last_frame": numbers[-1] if numbers else None,
            "missing": missing,
            "ended_early": self._ended_early,
            **facts,
            "parameters": self.settings,
            "versions": versions(),
        }

    def outcome(self, summary: dict[str, Any], *, signalled: bool = False) -> Outcome:
        """How the run has ended."""
        signal = self.interruption.signal if signalled else None
        return Outcome(summary, signal, self.in_words(summary))

    def seconds(self) -> float:
        """Wall time of the work, that before it was resumed included."""
        return self._earlier_seconds + time.perf_counter() - self._started
