import numpy as np
from rsmcm.models.numerics.compiled import compiled, exponential, logarithm, sigmoid


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


def test_exponential_of_very_small_numbers_is_next_to_nothing():
    x = np.array([-84, -100, -1e4, -1e6], np.float32)
    out = np.empty_like(x)
    exponentials(x, out)
    assert (out >= 0).all()
    assert (out < 1e-35).all()


def test_logarithm():
    x = np.geomspace(1e-37, 1e37, 200_001).astype(np.float32)
    out = np.empty_like(x)
    logarithms(x, out)
    np.testing.assert_allclose(out, np.log(x.astype(np.float64)), atol=2e-5)


def test_the_same_number_gives_the_same_logarithm_everywhere():
    x = np.ones(37, np.float32)  # whole vectors and a rest
    out = np.empty_like(x)
    logarithms(x, out)
    assert (out == out[0]).all()
