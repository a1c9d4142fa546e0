"""Compiled code that processes share, and that follows what it was made from."""

import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from rsmcm.models.numerics.compiled import digest_of

PROGRAM = """
from numba.core import event
import numpy as np
from rsmcm.models.core.gaussian_message import invert

class Compiled(event.Listener):
    names = []
    def on_start(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass

with event.install_listener("numba:compile", Compiled()):
    inverses, products = np.empty((1, 2, 2)), np.empty((1, 2))
    matrices, regular = np.array([[[2.0, 1.0], [1.0, 3.0]]]), np.empty(1, bool)
    invert(matrices, np.ones((1, 2)), 0.0, inverses, products, np.empty(1), regular)
print("invert" in Compiled.names, inverses.tobytes().hex())
"""


def test_one_of_two_processes_compiles_and_both_have_its_code(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    both = [
        subprocess.Popen([sys.executable, "-c", PROGRAM], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    said = [process.communicate(timeout=120)[0].split() for process in both]
    assert sorted(compiled for compiled, _ in said) == ["False", "True"]
    assert said[0][1] == said[1][1]


CALLED = """
import numpy as np
from rsmcm.models.numerics.compiled import compiled, inlined

STEP, OTHER = 0.25, 15.0
TABLE = np.arange(5000.0)
PAIR = (1.0, TABLE)

@inlined
def smaller(x):
    return x - STEP + 0 * OTHER

@compiled
def larger(x):
    'In steps.'
    return smaller(x) + TABLE[1] + 2.0
"""

CALLER = """
import numpy as np
from rsmcm.models.numerics.compiled import compiled
from called import larger

@compiled
def twice(x):
    return 2.0 * larger(x)

@compiled
def before(x):
    return after(x)

@compiled
def after(x):
    return x + np.float64(1)
"""


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def write(called: str, caller: str) -> tuple[ModuleType, ModuleType]:
        for name, text in (("called", called), ("caller", caller)):
            path = tmp_path / f"{name}.py"
            if not path.exists() or path.read_text() != text:
                path.write_text(text)
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        return importlib.import_module("called"), importlib.import_module("caller")

    yield write
    for name in ("called", "caller"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("old", "new", "changes"),
    [
        ("STEP, OTHER = 0.25", "STEP, OTHER = 0.5", True),
        ("STEP, OTHER = 0.25, 15.0", "STEP, OTHER = 0.251, 5.0", True),
        ("arange(5000.0)", "arange(5000.0)[::-1].copy()", True),
        ("x - STEP", "x + STEP", True),
        ("@inlined", "@compiled", True),
        ("TABLE[1]", "PAIR[1][1]", True),
        ("(1.0, TABLE)", "(1.5, TABLE)", False),
        ("+ 2.0", "+ 3.0", True),
        ("In steps.", "By steps.", False),
        ("@inlined", "# smaller\n@inlined", False),
    ],
)
def test_what_is_called_is_part_of_the_digest(modules, old: str, new: str, changes: bool) -> None:
    first = modules(CALLED, CALLER)[1]
    again = modules(CALLED, CALLER)[1]
    other = modules(CALLED.replace(old, new), CALLER)[1]
    assert digest_of(first.twice) == digest_of(again.twice)
    assert (digest_of(first.twice) != digest_of(other.twice)) == changes
    assert digest_of(first.before) == digest_of(other.before)


def test_what_comes_later_in_a_file_and_what_calls_itself(modules) -> None:
    first = modules(CALLED, CALLER)[1]
    other = modules(CALLED, CALLER.replace("np.float64(1)", "np.float64(2) + (after(x) if x > 9 else 0)"))[1]
    assert digest_of(first.before) != digest_of(other.before)
    assert digest_of(first.twice) == digest_of(other.twice)


def test_code_on_disk_is_made_again_where_a_constant_elsewhere_has_changed(modules) -> None:
    assert modules(CALLED, CALLER)[1].twice(1.0) == 7.5
    kept = modules(CALLED, CALLER)[1].twice
    assert kept(1.0) == 7.5
    assert sum(kept.stats.cache_hits.values()) == 1
    assert modules(CALLED.replace("STEP, OTHER = 0.25", "STEP, OTHER = 0.5"), CALLER)[1].twice(1.0) == 7.0


SUM_OF_PAIR = """
from typing import NamedTuple
from rsmcm.models.numerics.compiled import compiled
class Pair(NamedTuple):
    one: float
    other: float
@compiled
def total(pair):
    return pair[0] + pair[1]
"""


def test_code_on_disk_is_made_again_where_a_type_is_no_more(modules) -> None:
    first = modules(CALLED, SUM_OF_PAIR)[1]
    assert first.total(first.Pair(1.0, 2.0)) == 3.0
    second = modules(CALLED, SUM_OF_PAIR.replace("Pair", "Couple"))[1]
    assert second.total(second.Couple(1.0, 2.0)) == 3.0
