"""Arrays that are used again once nobody looks at them any more.

States are values: every frame makes new arrays, and whoever keeps an old state keeps its arrays. Asking the
operating system for fresh pages costs more than the work on a frame, so arrays whose last reader is gone are
handed out again.
"""

import os
import sys
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

Scalar = TypeVar("Scalar", bound=np.generic)

_LONGEST_LIST = 12

_pool: dict[tuple[tuple[int, ...], str], list[NDArray[Any]]] = {}
_lock = Lock()

if hasattr(os, "register_at_fork"):  # what another thread holds at that moment would stay locked in the child
    os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release)


def empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Give an uninitialised array of `shape` and `dtype`, one that nobody refers to any more if there is one.

    Views count as references, so an array is handed out again only when no view of it is left either.
    """
    key = (shape, np.dtype(dtype).str)
    with _lock:
        arrays = _pool.setdefault(key, [])
        for array, references in zip(arrays, _references(arrays), strict=True):
            if references == _IDLE:
                return array
        array = np.empty(shape, dtype)
        if len(arrays) == _LONGEST_LIST:
            arrays.pop(0)
        arrays.append(array)
        return array


def copy(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """Give a copy in an array of `empty`."""
    out = empty(array.shape, array.dtype)
    np.copyto(out, array)
    return out


def _references(arrays: list[NDArray[Any]]) -> list[int]:
    return [sys.getrefcount(array) for array in arrays]


# what is counted for an array that only its list refers to: it differs between versions of Python
_IDLE = _references([np.empty(0)])[0]
