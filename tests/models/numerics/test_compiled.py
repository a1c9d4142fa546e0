"""Compiled arithmetic against numpy."""

import numpy as np
from rsmcm.models.numerics.compiled import (
    LANES,
    MOST,
    add_vector,
    add_vectors,
    compiled,
    exponential,
    logarithm,
    own_array,
    sigmoid,
)


@compiled
def exponentials(x, out):
    for i in range(x.size):
        out[i] = exponential(x[i])


@compiled
def logarithms(x, out):
    for i in range(x.size):
        out[i] = logarithm(x[i])


@compiled
def sigmoids(x, out):
    for i in range(x.size):
        out[i] = sigmoid(x[i])


def test_sigmoid():
    x = np.linspace(-6, 6, 20_001, dtype=np.float32)
    out = np.empty_like(x)
    sigmoids(x, out)
    np.testing.assert_allclose(out, 1 / (1 + np.exp(-x.astype(np.float64))), atol=1e-6)


def test_exponential():
    x = np.linspace(-80, 80, 200_001, dtype=np.float32)
    out = np.empty_like(x)
    exponentials(x, out)
    # 2e-5 includes the argument's rounding after scaling by log2(e), 115 * 6e-8
    np.testing.assert_allclose(out, np.exp(x.astype(np.float64)), rtol=2e-5)
    x = np.array([-84, -100, -1e4, -1e6], np.float32)
    exponentials(x, out)
    assert ((out[:4] >= 0) & (out[:4] < 1e-35)).all()


def test_logarithm():
    x = np.geomspace(1e-37, 1e37, 200_001).astype(np.float32)
    out = np.empty_like(x)
    logarithms(x, out)
    np.testing.assert_allclose(out, np.log(x.astype(np.float64)), atol=2e-5)
    logarithms(np.ones(37, np.float32), out)  # whole vectors and a rest give the same
    assert (out[:37] == out[0]).all()


@compiled
def _added(target, at, a, x, i, b, y, j):
    add_vector(target, at, a, x, i)
    add_vectors(target, at, a, x, i, b, y, j)


@compiled
def _in_own_arrays(values, out):
    squares, numbers = own_array(np.float32), own_array(np.uint32)
    for k in range(MOST):
        squares[k] = values[k] * values[k]
        numbers[k] = np.uint32(k)
    for k in range(MOST):
        out[k] = squares[k] + np.float32(numbers[k])


def test_vectors_are_added_in_their_place_only() -> None:
    random = np.random.default_rng(0)
    target, x, y = random.normal(size=(3, 3 * LANES)).astype(np.float32)
    wanted = target.copy()
    wanted[5 : 5 + LANES] += 4 * x[3 : 3 + LANES] - 0.5 * y[9 : 9 + LANES]
    _added(target, 5, np.float32(2.0), x, 3, np.float32(-0.5), y, 9)
    np.testing.assert_allclose(target, wanted, rtol=1e-5, atol=1e-6)
    untouched = np.r_[0:5, 5 + LANES : 3 * LANES]
    np.testing.assert_array_equal(target[untouched], wanted[untouched])


def test_a_vector_may_be_added_to_itself() -> None:
    both = np.arange(2 * LANES, dtype=np.float32)
    _added(both, 0, np.float32(1), both, 0, np.float32(1), both, LANES)
    first, second = np.arange(2 * LANES).reshape(2, LANES)
    np.testing.assert_array_equal(both, np.r_[4 * first + second, second])


def test_own_arrays_do_not_share_their_place() -> None:
    values = np.linspace(-3, 3, MOST).astype(np.float32)
    out = np.empty(MOST, np.float32)
    _in_own_arrays(values, out)
    np.testing.assert_allclose(out, values**2 + np.arange(MOST), rtol=1e-6)
