"""One way to compile a loop: numba, without the interpreter's lock, kept on disk between runs."""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

Function = Callable[..., Any]


def compiled(function: Function) -> Function:
    """Compile `function` with numba on its first call.

    Fast-math is on (sums may be reordered, as vector units need), so kernels must not rely on NaN or
    infinity; results are still the same on every run of the same machine code.
    """
    jitted: Function = numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")(function)
    return jitted


def inlined(function: Function) -> Function:
    """Compile a small function so that the loops that call it are vectorised as a whole."""
    jitted: Function = numba.njit(cache=True, fastmath=True, error_model="numpy", inline="always")(function)
    return jitted


def _intrinsic(function: Function) -> Function:
    """Make LLVM code a function of its arguments without the typing context that writes it."""
    made: Function = intrinsic(function)
    return made


@_intrinsic
def _bits_as_float(typing_context: Any, bits: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.FloatType())

    return numba.types.float32(numba.types.int32), generate


@_intrinsic
def _float_as_bits(typing_context: Any, number: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(32))

    return numba.types.int32(numba.types.float32), generate


_f4 = np.float32


@inlined
def exponential(x: Any) -> Any:
    """exp(x) for float32 x <= 80, relative error below 1e-4 (libm's is no vector code); about 1e-36 below -83."""
    scaled = max(x * _f4(1.44269504), _f4(-120.0))
    whole = np.int32(scaled + _f4(128.0)) - np.int32(128)
    rest = (scaled - _f4(whole)) * _f4(0.69314718)
    power = _f4(0.041666667) + rest * _f4(0.0083333333)
    power = _f4(0.5) + rest * (_f4(0.16666667) + rest * power)
    power = _f4(1.0) + rest * (_f4(1.0) + rest * power)
    return power * _bits_as_float((whole + np.int32(127)) << np.int32(23))


@inlined
def logarithm(x: Any) -> Any:
    """log(x) for normal float32 x > 0, absolute error below 1e-4."""
    bits = _float_as_bits(x)
    exponent = _f4((bits >> np.int32(23)) - np.int32(127))
    mantissa = _bits_as_float((bits & np.int32(0x007FFFFF)) | np.int32(0x3F800000))
    # log of the mantissa in [1, 2) by the series of artanh, centred at sqrt(2)
    ratio = (mantissa - _f4(1.41421356)) / (mantissa + _f4(1.41421356))
    square = ratio * ratio
    series = ratio * (_f4(2.0) + square * (_f4(0.66666667) + square * (_f4(0.4) + square * _f4(0.28571429))))
    return (exponent + _f4(0.5)) * _f4(0.69314718) + series
