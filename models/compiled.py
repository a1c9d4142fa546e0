"""One way to compile a loop: numba, without the interpreter's lock, kept on disk between runs."""

from collections.abc import Callable
from typing import TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile `function` with numba on its first call.

    Fast-math is on (sums may be reordered, as vector units need), so kernels must not rely on NaN or
    infinity; results are still the same on every run of the same machine code.
    """
    jitted: Function = numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")(function)
    return jitted
