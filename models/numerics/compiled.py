"""One way to compile a loop: numba, without the interpreter's lock, kept on disk between runs.

Also what loops need that numba does not have: logarithms and exponentials that are vector code, and whole
vectors where a compiler that cannot tell arrays apart would go number by number.

Functions that a loop calls become part of its code, as do constants that it names, in whatever file they are,
while numba looks at the loop's own file alone. Therefore compiled code is kept in a folder that is named by a
digest of the loop's module and of all modules that it imports from the package.
"""

import gc
import hashlib
import logging
import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Self

import numba
import numpy as np
from llvmlite import ir
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic
from numba.misc.appdirs import user_cache_dir
from numba.np.numpy_support import carray

Function = Callable[..., Any]

_config: Any = numba.config
_log = logging.getLogger(__name__)


def compiled(function: Function) -> Function:
    """Compile `function` with numba on its first call.

    Fast-math is on (sums may be reordered, as vector units need), so kernels must not rely on NaN or
    infinity; results are still the same on every run of the same machine code.
    """
    # Nothing calls them from C, and every function that is not made shortens the first start. What they
    # call is inlined: else it is the copy that the process has met first, and copies differ in last digits.
    options: dict[str, Any] = {"no_cfunc_wrapper": True, "forceinline": True}
    return _kept(numba.njit(nogil=True, fastmath=True, error_model="numpy", **options)(function))


def inlined(function: Function) -> Function:
    """Compile a small function so that the loops that call it are vectorised as a whole."""
    return _kept(numba.njit(fastmath=True, error_model="numpy", inline="always")(function))


def helper(function: Function) -> Function:
    """Compile a function that only loops call; LLVM inlines it.

    Unlike an `inlined` one it is typed once and not in each place where it is called, which compiles sooner.
    """
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "forceinline": True}
    return _kept(numba.njit(fastmath=True, error_model="numpy", **options)(function))


class _Compilation(event.Listener):
    """Counts the seconds in which numba compiles, and pauses the collection of garbage meanwhile.

    Collecting would take a seventh of that time.
    """

    def __init__(self) -> None:
        self._depth, self._was_enabled = 0, False  # one thread at a time compiles
        self._began = self.seconds = 0.0

    def on_start(self, _: Any) -> None:
        """Begin with the outermost function; those that it calls are compiled within."""
        if self._depth == 0:
            self._was_enabled, self._began = gc.isenabled(), time.perf_counter()
            gc.disable()
        self._depth += 1

    def on_end(self, _: Any) -> None:
        """End with the outermost function."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began
            if self._was_enabled:
                gc.enable()


COMPILES = "numba:compile"
"""numba's event: a function that is not in its cache is compiled. Its data names the `dispatcher`."""

_compilation = _Compilation()
event.register(COMPILES, _compilation)  # type: ignore[no-untyped-call]


def compile_seconds() -> float:
    """Return for how long this process has compiled until now."""
    return _compilation.seconds


def work_clock() -> float:
    """Return the time of a clock, s, that stands still while loops are compiled: that of all speeds."""
    return time.perf_counter() - _compilation.seconds


class _Locator:
    """Tells numba in which folder the code of a function is, which may be a read-only one.

    The name of the folder follows from the sources, so that their dates need not be compared.
    """

    def __init__(self, function: Function, file: str) -> None:
        self._py_file = file  # which numba names in warnings
        self._folder = cache_folder(Path(file), _config.CACHE_DIR)
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Function, file: str) -> Self:
        return cls(function, file)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return str(self._line)

    def ensure_cache_path(self) -> None:
        os.makedirs(self.get_cache_path(), exist_ok=True)


class _Files(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 - as numba has it


class _Cache(FunctionCache):
    """numba's cache of a function, whose index one process at a time changes."""

    _impl_class = _Files

    def save_overload(self, signature: Any, result: Any) -> None:
        from filelock import FileLock  # which takes a while to import

        try:
            os.makedirs(self.cache_path, exist_ok=True)
            with FileLock(os.path.join(self.cache_path, "lock"), timeout=10.0, mode=0o666):
                super().save_overload(signature, result)  # type: ignore[no-untyped-call]
        except OSError:  # full or read-only: it is compiled again next time
            _warn()


class _Nowhere(NullCache):
    """The cache of a function where there is no folder for it."""

    def save_overload(self, signature: Any, result: Any) -> None:
        _warn()


@cache
def _warn() -> None:
    """Say once in a process that code is not kept."""
    usual = _config.CACHE_DIR
    where = f"in {usual}" if usual else "beside its modules or with the user's caches"
    _log.warning("compiled code cannot be kept %s: each process compiles anew (see NUMBA_CACHE_DIR)", where)


def is_kept(function: Any) -> bool:
    """Whether the code of a function that is compiled now is kept on disk."""
    cache = function._cache
    return isinstance(cache, _Cache) and os.access(cache.cache_path, os.W_OK)


_IMPORT = re.compile(rb"^from (\.+)([\w.]*) import", re.MULTILINE)


def _kept(function: Any) -> Function:
    """Have what a function is compiled to kept on disk, if there is a folder for it."""
    kept: Any = function
    if isinstance(function, Dispatcher):  # it is none where numba is told to compile nothing
        file = Path(function.py_func.__code__.co_filename)
        if cache_folder(file, _config.CACHE_DIR) is not None:
            kept._cache = _Cache(function.py_func)  # type: ignore[no-untyped-call]
        elif file.exists():  # no notebook's
            kept._cache = _Nowhere()
    return kept  # type: ignore[no-any-return]


@cache
def cache_folder(module: Path, usual: str) -> Path | None:
    """Return the folder of the compiled code of a module: in numba's `usual` one, if it is set.

    Otherwise beside the module, or where the user's caches are. If none of them can be written to, it is one
    that was filled before, or `None`.
    """
    if not module.exists():  # of a notebook
        return None
    module = module.resolve()
    name = f"{module.stem}-{_digest(module)}"
    beside = module.parent / "__pycache__"
    of_user = Path(user_cache_dir("rsmcm", False))  # type: ignore[no-untyped-call]
    bases = [Path(usual), beside] if usual else [beside]
    if not usual and of_user.is_absolute():  # else nobody knows where the user's home is
        bases.append(of_user)
    for base in bases:
        folder = base / name
        with suppress(OSError):
            if base == beside and not folder.exists():  # of earlier states of the sources
                for old in base.glob(f"{module.stem}-{'[0-9a-f]' * 16}"):
                    shutil.rmtree(old, ignore_errors=True)
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder
    return next((base / name for base in bases if any((base / name).glob("*.nbi"))), None)


def _digest(module: Path) -> str:
    """Return a digest of a module's source and of all modules that it imports by relative imports."""
    sources: dict[Path, bytes] = {}
    waiting = [module]
    while waiting:
        path = waiting.pop()
        if path in sources or not path.exists():
            continue
        sources[path] = path.read_bytes()
        for dots, name in _IMPORT.findall(sources[path]):
            target = path.parents[len(dots) - 1].joinpath(*name.decode().split("."))
            waiting.extend(target.glob("*.py") if target.is_dir() else [target.with_suffix(".py")])
    return hashlib.sha256(b"\0".join(sources[path] for path in sorted(sources))).hexdigest()[:16]


@compiled
def put(values: Any, place: Any) -> None:
    """Copy numbers along one axis.

    numba's own `place[:] = values` takes three seconds more to compile, for the text of its error message.
    """
    for i in range(place.size):
        place[i] = values[i]


def llvm_code(function: Function) -> Function:
    """Make LLVM code a function of its arguments without the typing context that writes it."""
    made: Function = intrinsic(function)
    return made


@llvm_code
def _bits_as_float(typing_context: Any, bits: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.FloatType())

    return numba.types.float32(numba.types.int32), generate


@llvm_code
def float_as_bits(typing_context: Any, number: Any) -> Any:
    """Give the int32 of the same bits; those of numbers above 0 are in the same order."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(32))

    return numba.types.int32(numba.types.float32), generate


_f4 = np.float32


@inlined
def exponential(x: Any) -> Any:
    """exp(x) for float32 x <= 80, relative error below 2e-5 (libm's is no vector code); 1e-36 below -83."""
    scaled = max(x * _f4(1.44269504), _f4(-120.0))
    whole = np.int32(scaled + _f4(128.5)) - np.int32(128)
    rest = scaled - _f4(whole)
    # 2 ** rest from -1/2 to 1/2, by Chebyshev points
    power = _f4(0.05592204) + rest * _f4(0.00967604)
    power = _f4(0.69312103) + rest * (_f4(0.24022107) + rest * power)
    return (_f4(1.0) + rest * power) * _bits_as_float((whole + np.int32(127)) << np.int32(23))


@inlined
def logarithm(x: Any) -> Any:
    """log(x) for normal float32 x > 0, absolute error below 2e-5."""
    bits = float_as_bits(x)
    exponent = _f4((bits >> np.int32(23)) - np.int32(127))
    mantissa = _bits_as_float((bits & np.int32(0x007FFFFF)) | np.int32(0x3F800000))
    # log of the mantissa from 1 to 2, by Chebyshev points about the middle
    rest = mantissa - _f4(1.5)
    series = _f4(0.09823154) + rest * (_f4(-0.05545931) + rest * _f4(0.030449))
    series = _f4(0.40545679) + rest * (_f4(0.66668367) + rest * (_f4(-0.22163318) + rest * series))
    return exponent * _f4(0.69314718) + series


@inlined
def falling(x: Any) -> Any:
    """exp(x) for float64 x <= 0, error below 1e-13 (libm's is no vector code)."""
    # to the 256th part, where a short series is enough, and back by squaring
    small = max(x, -80.0) * (1 / 256)
    power = 1 / 24 + small * (1 / 120 + small / 720)
    power = 1.0 + small * (1.0 + small * (0.5 + small * (1 / 6 + small * power)))
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * power


@inlined
def sigmoid(x: Any) -> Any:
    """1 / (1 + exp(-x)) for float32 x from -6 to 6, absolute error below 1e-6."""
    half = _f4(0.5) * x
    square = half * half
    # continued fraction of the hyperbolic tangent
    above = half * (_f4(135135.0) + square * (_f4(17325.0) + square * (_f4(378.0) + square)))
    below = _f4(135135.0) + square * (_f4(62370.0) + square * (_f4(3150.0) + square * _f4(28.0)))
    return _f4(0.5) + _f4(0.5) * above / below


LANES = 16  # numbers of a vector
MOST = 256  # numbers that an array of a loop's own holds

_FLOATS = ir.VectorType(ir.FloatType(), LANES)


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), ir.PointerType(_FLOATS))


def _everywhere(builder: Any, number: Any) -> Any:
    first = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(
        first, first, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    )


def _adding(terms: int) -> Function:
    def typed(typing_context: Any, target: Any, at: Any, *products: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kinds = signature.args
            where = _place(context, builder, kinds[0], arguments[0], arguments[1])
            total = builder.load(where, align=4)
            for first in range(2, 2 + 3 * terms, 3):
                factor, array, index = arguments[first : first + 3]
                source = builder.load(_place(context, builder, kinds[first + 1], array, index), align=4)
                product = builder.fmul(_everywhere(builder, factor), source, flags=("fast",))
                total = builder.fadd(total, product, flags=("fast",))
            builder.store(total, where, align=4)
            return context.get_dummy_value()

        index, number = numba.types.intp, numba.types.float32
        parts = [part for k in range(terms) for part in (number, products[3 * k + 1], index)]
        return numba.types.void(target, index, *parts), generate

    return typed


@llvm_code
def add_vector(typing_context: Any, target: Any, at: Any, a: Any, x: Any, i: Any) -> Any:
    """Add a x[i : i + 16] to target[at : at + 16]; float32, 1-D."""
    return _adding(1)(typing_context, target, at, a, x, i)


@llvm_code
def add_vectors(
    typing_context: Any, target: Any, at: Any, a: Any, x: Any, i: Any, b: Any, y: Any, j: Any
) -> Any:
    """Add a x[i : i + 16] + b y[j : j + 16] to target[at : at + 16]; float32, 1-D."""
    return _adding(2)(typing_context, target, at, a, x, i, b, y, j)


@llvm_code
def _on_stack(typing_context: Any, kind: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        room = ir.ArrayType(context.get_value_type(kind.dtype), MOST)
        with builder.goto_entry_block():
            return builder.bitcast(builder.alloca(room), ir.PointerType(room.element))

    pointer: Any = numba.types.CPointer
    return pointer(kind.dtype)(kind), generate


@inlined
def own_array(kind: Any) -> Any:
    """A 1-D array of `MOST` numbers of a `kind`, on the stack: nothing else can be in its place.

    Loops that write to such arrays only are vectorised without asking whether they overlap with what is read.
    """
    return carray(_on_stack(kind), (MOST,))
