"""A run in its folder of results: what all applications have in common there, and versions."""

import importlib.metadata
import logging
import platform
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import cv2
from numba.core import event
from tqdm import tqdm

from ...models.numerics.compiled import COMPILES, is_kept, work_clock
from ..io.files import segment_pattern
from ..io.row_log import COLUMNS, remove_rows
from ..options.job import Job
from ..view.film import FILM, ROWS
from ..view.page import VIEW
from .interruption import Interrupted, Interruption, Outcome
from .messages import is_shown
from .output_folder import OutputFolder, output_folder
from .saved_run import STATE

OVERLAY = "overlay.mp4"

COMPILING = "5 s to 2 minutes"
"""Of first runs: on an Intel Xeon face 6, body 18, structure 53 s; on an AMD EPYC background 110 s."""

_GROWING = (OVERLAY, FILM, ROWS)
ALWAYS = (STATE, "summary.json", VIEW, *_GROWING, *map(segment_pattern, _GROWING))
"""Files that every run may leave."""


class _Announcement(event.Listener):
    """Writes a line when a function is compiled whose code is kept for later runs."""

    def __init__(self, application: str) -> None:
        self._application = application
        self._is_due = is_shown(logging.WARNING)

    def on_start(self, compilation: Any) -> None:
        """Write the line, once."""
        if self._is_due and is_kept(compilation.data["dispatcher"]):
            self._is_due = False
            once = f"which is done once and takes {COMPILING}"
            tqdm.write(f"{self._application}: compiling for this machine, {once}", file=sys.stderr)

    def on_end(self, _: Any) -> None:
        """Do nothing."""


class Session:
    """A run of an application from the lock of its folder to its summary.

    `settings` are what the results depend on, beside the source.

    Attributes
    ----------
    interruption
        whether a signal has arrived.
    fingerprint
        by which its source is known again.
    notes
        warnings, one sentence each.
    saved
        whether a state is saved with which the run can go on; how, `resume_hint` says.
    earlier_seconds
        of wall time, before the run was resumed.
    ended_early
        whether something else than the end of its source has ended it.
    live
        whether its source cannot be read again.
    """

    def __init__(self, application: str, job: Job, settings: dict[str, Any]) -> None:
        self.application, self.job, self.settings = application, job, settings
        self.interruption = Interruption()
        self.fingerprint: dict[str, Any] = {}
        self.notes: list[str] = []
        self.saved = self.ended_early = self.live = False
        self.resume_hint = f"--resume continues {job.out}"
        self.earlier_seconds = 0.0
        self._started = work_clock()
        self._folder: OutputFolder

    @contextmanager
    def running(self) -> Iterator[None]:
        """Hold the folder's lock; a first SIGINT (Ctrl-C) or SIGTERM is noted, a second one ends the run.

        It is a ValueError or OSError if the folder holds other results, or another run writes there, and
        Interrupted if a signal came before there was any result, or a second one; it says how the run goes
        on.
        """
        job = self.job
        try:
            with (
                self.interruption,
                output_folder(
                    job.out, self.application, overwrite=job.overwrite, resume=job.resume
                ) as self._folder,
                event.install_listener(COMPILES, _Announcement(self.application)),
            ):
                yield
        except Interrupted as stop:
            if not self.saved:
                raise
            raise Interrupted(stop.signal, f"interrupted: {self.resume_hint}") from None

    def begin_results(self, files: Sequence[str]) -> None:
        """Make the folder ready for these files, patterns of `glob` among them, and those of every run."""
        self._folder.begin([*ALWAYS, *files], resume=self.job.resume)

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
            "first_frame": numbers[0] if len(numbers) else None,
            "last_frame": numbers[-1] if len(numbers) else None,
            "missing": missing,
            "ended_early": self.ended_early,
            **facts,
            "parameters": self.settings,
            "versions": versions(),
        }

    def outcome(self, summary: dict[str, Any], words: Sequence[str]) -> Outcome:
        """How the run has ended, in a few words; if none can go on with it, what that needs is removed."""
        if self.live or not self.ended_early:
            self._folder.drop_segments()
            remove_rows(self.job.out / COLUMNS)
        return Outcome(summary, self.interruption.signal if self.ended_early else None, words)

    def seconds(self) -> float:
        """Wall time of the work, that before it was resumed included, without that of compiling."""
        return self.earlier_seconds + work_clock() - self._started


def versions() -> dict[str, str]:
    """Version of what a result depends on, by name."""
    found = {"python": platform.python_version()}
    for name in ("rsmcm", "numpy", "scipy", "numba", "av"):
        found[name] = importlib.metadata.version(name)
    return {**found, "opencv": cv2.__version__}
