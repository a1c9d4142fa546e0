"""Distances to edges and which way the edges face."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.body.image_features import edge_distances
from scipy.ndimage import distance_transform_edt

Image = NDArray[np.uint8]


def disc(contrast: float, size: tuple[int, int] = (120, 160), radius: float = 35.0) -> Image:
    """A soft disc in the middle on grey 60."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    distance = np.hypot(columns - size[1] / 2, rows - size[0] / 2)
    return (60 + contrast / (1 + np.exp(distance - radius))).astype(np.uint8)


@pytest.mark.parametrize("contrast", [12, 60, 180])
def test_a_disc_has_its_circle_as_edge(contrast: float) -> None:
    """Thresholds are relative to the image's own gradients, so the contrast does not matter."""
    distances, directions = edge_distances(disc(contrast), 12.0)
    rows, columns = np.mgrid[:120, :160]
    right, down = columns - 80, rows - 60
    radius = np.hypot(right, down)
    near = np.abs(radius - 35) < 9
    # the edge's pixels are up to one off the circle
    np.testing.assert_allclose(distances[near], np.abs(radius - 35)[near], atol=1.6)
    turned = np.abs(directions - np.arctan2(down, right))[near & (radius > 20)] % np.pi
    assert np.quantile(np.minimum(turned, np.pi - turned), 0.95) < 0.2
    assert distances[60, 80] == np.float32(12.0)


def test_distances_are_euclidean() -> None:
    image = np.random.default_rng(2).integers(0, 255, (6, 8)).astype(np.uint8).repeat(20, 0).repeat(20, 1)
    distances, directions = edge_distances(image, 15.0)
    exact = np.minimum(distance_transform_edt(distances > 0), 15.0)
    np.testing.assert_allclose(distances, exact, atol=0.3)  # a 5x5 mask's distances are 2 % off at most
    assert (distances.dtype, directions.dtype) == (np.float32, np.float32)
    assert (directions >= 0).all()
    assert (directions <= np.pi).all()


@pytest.mark.parametrize("shape", [(40, 60), (40, 60, 3)])
def test_no_edge_in_an_even_picture(shape: tuple[int, ...]) -> None:
    distances, directions = edge_distances(np.full(shape, 90, np.uint8), 7.0)
    assert (distances == 7).all()
    assert not directions.any()


def test_noise_is_hardly_an_edge() -> None:
    noise = np.random.default_rng(0).normal(100, 6, (200, 300))
    distances, _ = edge_distances(noise.clip(0, 255).astype(np.uint8), 15.0)
    assert (distances == 0).mean() < 0.03
