"""Libraries that write to standard error by themselves, which belongs to the one line of an error."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

STANDARD_ERROR = 2
_one_at_a_time = threading.Lock()


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Drop what is written to standard error inside the block, also by C (decoders of PNG, JPEG and TIFF).

    It is for a few ms: what other threads write there meanwhile is dropped as well; see
    `own_standard_error`.
    """
    with _one_at_a_time:
        try:
            kept = os.dup(STANDARD_ERROR)
        except OSError:  # closed: nothing can be written
            yield
            return
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, STANDARD_ERROR)
            yield
        finally:
            os.dup2(kept, STANDARD_ERROR)
            os.close(nowhere)
            os.close(kept)


@contextmanager
def own_standard_error() -> Iterator[None]:
    """Have what Python writes to standard error inside the block go past `quiet_libraries`.

    It goes through a descriptor of its own, so that only what C writes is dropped.
    """
    before = sys.stderr
    try:
        shared = before is not None and before.fileno() == STANDARD_ERROR
    except (OSError, ValueError):  # no file at all
        shared = False
    if not shared:
        yield
        return
    with os.fdopen(
        os.dup(STANDARD_ERROR), "w", buffering=1, encoding=before.encoding, errors=before.errors
    ) as sys.stderr:
        try:
            yield
        finally:
            sys.stderr = before
