"""Compiled code on disk, made once for all processes, and again where anything that it was made from changes.

What a loop is compiled to may depend on which of the loops that it calls were on disk by then: sums are
ordered in another way, so that two processes which compile the same one may have results that differ in the
last digits. Here the first one compiles, and those who come meanwhile wait for what it leaves.

What a loop calls becomes part of its code, and so do the constants that it names, in whatever file they are.
numba looks at the loop's own file alone: code from before an upgrade would run on where only they have
changed.
"""

import hashlib
import os
from contextlib import suppress
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.caching import FunctionCache

PATIENCE = 120.0
"""s for which another process is waited for; one that has failed to compile keeps its lock until it ends."""


class CodeCache(FunctionCache):
    """numba's cache of a function, of which one process at a time fills in what is missing.

    Parameters
    ----------
    function
        that numba compiles.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function.py_func)  # type: ignore[no-untyped-call]
        self._function = function
        self._lock: Any = None  # held while this process compiles
        self._stamped = False

    def load_overload(self, signature: Any, context: Any) -> Any:
        """What is kept for these types; where nothing is, the caller compiles it and nobody else does."""
        if not self._stamped:  # only now: what a function calls may come after it in its file
            self._cache_file._source_stamp = digest_of(self._function)
            self._stamped = True
        found = self._found(signature, context)
        if found is None and self._lock is None:
            from filelock import FileLock  # which takes a while to import

            path = os.path.join(self.cache_path, f"{self._impl.filename_base}.lock")
            self._lock = FileLock(path, PATIENCE, 0o666)
            with suppress(OSError):  # also where it takes too long: on without the lock
                self._impl.locator.ensure_cache_path()
                self._lock.acquire()
            found = self._found(signature, context)
            if found is not None:
                self._release()
        return found

    def _found(self, signature: Any, context: Any) -> Any:
        try:
            return super().load_overload(signature, context)  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError):  # it was made for types that an upgrade has taken away
            self._cache_file.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, signature: Any, made: Any) -> None:
        """Keep what was compiled."""
        try:
            super().save_overload(signature, made)  # type: ignore[no-untyped-call]
        finally:
            self._release()

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None


def digest_of(function: Any) -> str:
    """What a function is compiled from, in short: code, options, what it calls, and constants that it names.

    Comments, docstrings and places in the file are left out.
    """
    digest, seen = hashlib.sha256(), set[int]()

    def note(*facts: object) -> None:
        digest.update(repr(facts).encode() + b"\0")

    def add_code(code: CodeType, named: dict[str, Any], text: str | None) -> None:
        note(code.co_code, code.co_varnames, code.co_names)
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                add_code(constant, named, None)
            elif constant != text:
                note(constant)
        modules = [value for name in code.co_names if isinstance(value := named.get(name), ModuleType)]
        ours = [
            vars(module) for module in modules if module.__name__.startswith(__package__.partition(".")[0])
        ]
        for name in code.co_names:
            for names in (named, *ours):
                if name in names:
                    add(names[name])

    def add(value: Any) -> None:
        note(sorted(getattr(value, "targetoptions", {}).items()))
        value = getattr(value, "py_func", getattr(value, "_defn", value))  # as numba wraps it
        if isinstance(value, FunctionType):
            if id(value) not in seen:
                seen.add(id(value))
                add_code(value.__code__, value.__globals__, value.__doc__)
                add(value.__defaults__)
                add(tuple(cell.cell_contents for cell in value.__closure__ or ()))
        elif isinstance(value, np.ndarray):
            note(value.dtype, value.shape, value.tobytes())
        elif isinstance(value, type):
            note(value.__qualname__, getattr(value, "_fields", ()))
        elif isinstance(value, tuple):
            note(type(value).__qualname__, len(value))
            for each in value:
                add(each)
        elif not isinstance(value, ModuleType):
            note(value)

    add(function)
    return digest.hexdigest()
