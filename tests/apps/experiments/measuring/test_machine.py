"""Limits are times of a plain copy and of a product of matrices."""

import time

import numpy as np
import pytest
from rsmcm.apps.experiments.measuring.machine import bandwidth, moving, multiplying, operations


def test_moving_takes_as_long_as_a_copy() -> None:
    size = 1 << 26
    source = np.ones(size // 2, np.uint8)
    target = source.copy()
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        np.copyto(target, source)
        seconds.append(time.perf_counter() - started)
    assert moving(size) < 2 * min(seconds)
    assert bandwidth(size) == pytest.approx(size / moving(size))


def test_twice_as_much_takes_twice_as_long() -> None:
    assert multiplying(2e9) == pytest.approx(2 * multiplying(1e9))
    assert multiplying(operations()) == pytest.approx(1.0)
    assert moving(0.0) == 0.0
