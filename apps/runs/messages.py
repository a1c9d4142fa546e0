"""Messages of a command: on standard error, and in a file.

They are those of Python's `logging`, by loggers below `rsmcm`. A program that uses the package as a library
says where they go; if it does not, warnings go to standard error.
"""

import logging
import sys
from pathlib import Path

from tqdm import tqdm

_package = logging.getLogger("rsmcm")


def show_messages(level: int, log: Path | None = None) -> None:
    """Show the package's messages from `level` on; above `logging.WARNING`, no progress is shown either.

    Those from `logging.INFO` on are appended to the file `log`, with their times. Modules say what they find
    out and decide as `logging.INFO`, by `logging.getLogger(__name__)`.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    for handler in _package.handlers:
        handler.close()
    _package.handlers = [_BesideProgress(level)]
    _package.setLevel(level)
    if log is not None:
        file = logging.FileHandler(log, encoding="utf-8")
        file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        _package.addHandler(file)
        _package.setLevel(min(level, logging.INFO))


def is_shown(level: int) -> bool:
    """Whether messages of this level are shown on standard error."""
    shown = [handler.level for handler in _package.handlers if isinstance(handler, _BesideProgress)]
    return _package.isEnabledFor(level) and all(level >= each for each in shown)


def say_wrong(line: str) -> None:
    """Write what is wrong to standard error, and to the file of messages."""
    print(f"rsmcm: {line}", file=sys.stderr)
    for handler in _package.handlers:
        if isinstance(handler, logging.FileHandler):
            handler.handle(_package.makeRecord("rsmcm", logging.ERROR, "", 0, line, (), None))


class _BesideProgress(logging.Handler):
    """Writes messages to standard error, above a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        tqdm.write(self.format(record), file=sys.stderr)
