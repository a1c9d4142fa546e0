import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.chains.pixels.background_prediction import colour


def image_of(seed, shape):
    return np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)


def test_planes_are_a_matrix_product():
    image = image_of(0, (7, 13, 3))
    expected = colour.FROM_BGR @ image.reshape(-1, 3).T
    # the kernel takes chroma from rounded luma weights: 1e-3 of 255 grey levels
    np.testing.assert_allclose(colour.to_planes(image), expected, atol=1e-3)
    grey = colour.to_planes(np.full((1, 1, 3), 90, np.uint8))[:, 0]
    np.testing.assert_allclose(grey, [90, 0, 0], atol=1e-3)
    # ITU-R BT.601: chroma is the difference of red or blue from luma, doubled
    red, blue = (colour.FROM_BGR @ bgr for bgr in ([0, 0, 255], [255, 0, 0]))
    np.testing.assert_allclose([red[1], blue[2]], [2 * 127.5, 2 * 127.5], rtol=5e-3)
    assert {0: 1.0, 1: 1.0, 3: pytest.approx(abs(np.linalg.det(colour.FROM_BGR)))} == colour.VOLUME


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 9), st.integers(1, 9))
def test_planes_and_back(seed, height, width):
    for image in (image_of(seed, (height, width, 3)), image_of(seed, (height, width))):
        np.testing.assert_array_equal(colour.to_image(colour.to_planes(image), (height, width)), image)
