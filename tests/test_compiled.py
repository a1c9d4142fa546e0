import numpy as np

from rsmcm.models.compiled import compiled, exponential, logarithm


@compiled
def exponentials(x, out):
    for i in range(x.size):
        out[i] = exponential(x[i])


@compiled
def logarithms(x, out):
    for i in range(x.size):
        out[i] = logarithm(x[i])


def test_exponential():
    x = np.linspace(-80, 80, 200_001, dtype=np.float32)
    out = np.empty_like(x)
    exponentials(x, out)
    # the argument is rounded to float32 after scaling by log2(e): 115 * 6e-8 more than the stated error
    np.testing.assert_allclose(out, np.exp(x.astype(np.float64)), rtol=1.2e-4)


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
    np.testing.assert_allclose(out, np.log(x.astype(np.float64)), atol=1e-4)


def test_the_same_number_gives_the_same_logarithm_everywhere():
    x = np.ones(37, np.float32)  # whole vectors and a rest
    out = np.empty_like(x)
    logarithms(x, out)
    assert (out == out[0]).all()
