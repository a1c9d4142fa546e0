"""Compiled code that processes share."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from rsmcm.models.numerics.code_cache import fcntl

PROGRAM = """
import sys, time
from numba.core import event
import numpy as np
from rsmcm.models.core.kernels.gaussians import invert

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


@pytest.mark.skipif(fcntl is None, reason="the system has no locks of this kind")
def test_one_of_two_processes_compiles_and_both_have_its_code(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    both = [
        subprocess.Popen([sys.executable, "-c", PROGRAM], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    said = [process.communicate(timeout=120)[0].split() for process in both]
    assert sorted(compiled for compiled, _ in said) == ["False", "True"]
    assert said[0][1] == said[1][1]
