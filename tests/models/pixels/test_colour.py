import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.chains.pixels.background_prediction import colour


def image_of(seed, shape):
    return np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)


def test_planes_are_a_matrix_product():
    image = image_of(0, (7, 13, 3))
    expected = colour.FROM_BGR @ image.reshape(-1, 3).T
    # the kernel takes chroma from rounded luma weights: 1e-3 of 255 grey levels
    np.testing.assert_allclose(colour.to_planes(image), expected, atol=1e-3)


def test_luma_and_chroma():
    grey = colour.to_planes(np.full((1, 1, 3), 90, np.uint8))[:, 0]
    np.testing.assert_allclose(grey, [90, 0, 0], atol=1e-3)
    blue = colour.to_planes(np.array([[[255, 0, 0]]], np.uint8))[:, 0]
    assert blue[2] > 200
    assert blue[1] < 0


def test_a_grey_image_is_its_own_plane():
    image = image_of(1, (5, 6))
    np.testing.assert_array_equal(colour.to_planes(image), image.reshape(1, -1).astype(np.float32))
    np.testing.assert_array_equal(colour.to_image(colour.to_planes(image), (5, 6)), image)


@given(st.integers(0, 1000), st.integers(1, 9), st.integers(1, 9))
def test_planes_and_back(seed, height, width):
    image = image_of(seed, (height, width, 3))
    np.testing.assert_array_equal(colour.to_image(colour.to_planes(image), (height, width)), image)


def test_volume_is_how_the_planes_stretch_space():
    rng = np.random.default_rng(4)
    corner, edges = rng.random(3), rng.random((3, 3))
    moved = [colour.FROM_BGR @ (corner + edge) - colour.FROM_BGR @ corner for edge in edges]
    assert abs(np.linalg.det(moved) / np.linalg.det(edges)) == pytest.approx(colour.VOLUME[3])
    assert colour.VOLUME[1] == 1.0
