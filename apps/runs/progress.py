"""Progress of a run on standard error, with rate and time left."""

import logging
import sys
import time
from types import TracebackType
from typing import Never, Self

from tqdm import auto, tqdm

from ...models.numerics.compiled import compile_seconds
from .messages import is_shown

SPARSE_SECONDS = 10.0  # between lines where standard error is no terminal


class Progress:
    """Progress: a bar in a terminal or a notebook, elsewhere a line every 10 s at most.

    Rates are without the time in which loops are compiled, and in a line without the first update and what an
    earlier run has `done`. A `total` of `None` is an unknown length; `unit` is in the plural.
    """

    def __init__(self, label: str, total: int | None, done: int = 0, unit: str = "frames") -> None:
        self._label = label
        self._unit = unit
        self._total = total
        self._first = self._done = done
        self._started: float | None = None  # when the first update was over
        self._printed, self._compiled = time.monotonic(), compile_seconds()
        self._shown = is_shown(logging.WARNING)
        self._bar: tqdm[Never] | None = None
        if self._shown and ("ipykernel" in sys.modules or sys.stderr.isatty()):
            self._bar = auto.tqdm(
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
            compiling, self._compiled = compile_seconds() - self._compiled, compile_seconds()
            self._bar.start_t += compiling
            self._bar.last_print_t += compiling
            self._bar.update(n_frames)
            return
        now = time.monotonic()
        if self._started is None:
            self._started, self._first, self._compiled = now, self._done, compile_seconds()
        if self._shown and now - self._printed >= SPARSE_SECONDS:
            self._printed = now
            working = now - self._started - (compile_seconds() - self._compiled)
            print(self._line(working), file=sys.stderr, flush=True)

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
