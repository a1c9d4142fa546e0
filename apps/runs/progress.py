"""What is said on standard error while a run goes on: progress, with rate and time left, and messages."""

import logging
import sys
import time
from types import TracebackType
from typing import Never, Self

from tqdm import tqdm

SPARSE_SECONDS = 10.0  # between lines where standard error is no terminal

_package = logging.getLogger("rsmcm")


def show_messages(level: int) -> None:
    """Show the package's messages from `level` on; above `logging.WARNING`, no progress is shown either.

    Modules say what they find out and decide as `logging.INFO`, by `logging.getLogger(__name__)`.
    """
    _package.handlers = [_BesideProgress()]
    _package.setLevel(level)


class _BesideProgress(logging.Handler):
    """Writes messages to standard error, above a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        tqdm.write(self.format(record), file=sys.stderr)


class Progress:
    """Progress: a bar in a terminal, elsewhere a line every 10 s at most.

    The rate in a line is without the first update, in which loops may be compiled for a minute, and without
    what an earlier run has `done`. A `total` of `None` is an unknown length; `unit` is in the plural.
    """

    def __init__(self, label: str, total: int | None, done: int = 0, unit: str = "frames") -> None:
        self._label = label
        self._unit = unit
        self._total = total
        self._first = self._done = done
        self._started: float | None = None  # when the first update was over
        self._printed = time.monotonic()
        self._shown = _package.isEnabledFor(logging.WARNING)
        self._bar: tqdm[Never] | None = None
        if self._shown and sys.stderr.isatty():
            self._bar = tqdm(
                total=total, initial=done, desc=label, unit=f" {unit}", dynamic_ncols=True, file=sys.stderr
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def update(self, n_frames: int = 1) -> None:
        """Count frames as done."""
        self._done += n_frames
        if self._bar is not None:
            self._bar.update(n_frames)
            return
        now = time.monotonic()
        if self._started is None:
            self._started, self._first = now, self._done
        if self._shown and now - self._printed >= SPARSE_SECONDS:
            self._printed = now
            print(self._line(now - self._started), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Leave the last state of the bar, and the cursor on a new line."""
        if self._bar is not None:
            self._bar.close()

    def _line(self, seconds: float) -> str:
        counted = self._done - self._first
        line = f"{self._label}: {self._done}"
        if self._total is not None:
            line += f" of {self._total}"
        line += f" {self._unit}"
        if counted > 0:
            rate = counted / seconds
            line += f", {rate:.1f} {self._unit}/s" if rate >= 1 else f", {seconds / counted:.1f} s each"
            if self._total is not None:
                left = max(0.0, (self._total - self._done) / rate)
                line += f", {tqdm.format_interval(left)} left"
        return line
