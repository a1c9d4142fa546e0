"""What other libraries do by themselves: threads, lines on standard error, missing or clashing packages."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import packages_distributions
from typing import Any

ONE_THREAD_EACH = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "BLIS_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}
"""Variables that libraries of linear algebra and OpenCV read when they are loaded.

How OpenBLAS rounds depends on the number of its threads, so it is not left to the user: results are the same
bytes on any machine of a kind.
"""


def have_one_thread() -> None:
    """Limit libraries that are not loaded yet to one thread each."""
    os.environ.update(ONE_THREAD_EACH)


EXPECTED = "opencv-python-headless"


def opencv_hint(error: BaseException) -> str:
    """What is added to the message of an error that other packages of OpenCV may have led to.

    It names the packages; it is empty if the error does not come from OpenCV, or there is only the one that
    is expected.
    """
    found = sorted(set(packages_distributions().get("cv2", []))) if _of_opencv(error) else []
    if not set(found) - {EXPECTED}:
        return ""
    return f" (cv2 comes from {' and '.join(found)}, expected {EXPECTED} alone: uninstall all, install that)"


def _of_opencv(error: BaseException | None) -> bool:
    """Whether OpenCV could not be imported or lacks something, or the error was raised because of that."""
    if error is None:
        return False
    lacks = isinstance(error, AttributeError) and getattr(error.obj, "__name__", "").split(".")[0] == "cv2"
    fails = isinstance(error, ImportError) and error.name == "cv2"
    return lacks or fails or _of_opencv(error.__cause__ or error.__context__)


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


def needed(package: str, extra: str = "") -> Any:
    """Import a package of an extra, whose name may be another; the ImportError says what to install."""
    try:
        return import_module(package)
    except ImportError as error:
        raise ImportError(
            f"this needs {package}: pip install 'rsmcm[{extra or package}]'", name=package
        ) from error
