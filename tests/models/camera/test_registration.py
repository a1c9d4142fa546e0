"""Registration of frames with a picture of the scene, against maps that are known."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.camera.moving_camera import AffineMap, ScenePicture
from scipy.ndimage import affine_transform

SIZE = (180, 240)
Image = NDArray[np.uint8]
Numbers = NDArray[np.float64]


def textured(seed: int) -> NDArray[np.float32]:
    """A picture with edges of all sizes, larger than what a camera sees of it."""
    random = np.random.default_rng(seed)
    picture = np.full((2 * SIZE[0], 2 * SIZE[1]), 110.0, np.float32)
    for _ in range(250):
        x, y = random.uniform(0, 2 * SIZE[1]), random.uniform(0, 2 * SIZE[0])
        width, height = random.uniform(4, 60, 2)
        corner, opposite = (int(x), int(y)), (int(x + width), int(y + height))
        cv2.rectangle(picture, corner, opposite, float(random.uniform(30, 220)), cv2.FILLED)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.0), np.float32)


def seen(picture: NDArray[np.float32], view: AffineMap, seed: int, noise: float = 3.0) -> Image:
    """What a camera shows: the scene's picture is the middle of the larger one."""
    inverse = cv2.invertAffineTransform(view.matrix)
    offset = inverse[::-1, 2] + np.array(SIZE) / 2
    # not by OpenCV, which rounds places to 1/32 px
    shown = affine_transform(picture, inverse[::-1, 1::-1], offset, SIZE)
    shown += noise * np.random.default_rng(seed).standard_normal(SIZE)
    return np.clip(np.rint(shown), 0, 255).astype(np.uint8)


def still() -> AffineMap:
    return AffineMap.identity(SIZE)


@pytest.mark.parametrize("amount", [0.3, 1.0, 4.0, 12.0])
def test_a_known_map_is_found_to_a_fiftieth_of_a_pixel(amount: float) -> None:
    picture = textured(1)
    scene = ScenePicture(seen(picture, still(), 0))
    for seed in range(5):
        share = np.array([1, 0.25, 0.25, 1, 0.25, 0.25])
        true = np.random.default_rng(seed).normal(0, amount, 6) * share
        found = scene.register(seen(picture, AffineMap(true, SIZE), seed + 1), still())
        assert AffineMap(found.map.parameters - true, SIZE).displacement < 0.03
        assert AffineMap(true, SIZE).displacement < 0.5 or found.explained > 0.5
        assert found.correlation > 0.9


def test_errors_are_as_large_as_the_covariance_says() -> None:
    picture = textured(2)
    scene = ScenePicture(seen(picture, still(), 0, noise=0.0))
    errors = []
    for seed in range(40):
        true = np.random.default_rng(seed).normal(0, 1, 6)
        found = scene.register(seen(picture, AffineMap(true, SIZE), seed + 1), still())
        off = found.map.parameters - true
        errors.append(off @ np.linalg.solve(found.covariance, off) / 6)
    assert 0.3 < np.mean(errors) < 1.5


def test_things_that_move_by_themselves_do_not_move_the_camera() -> None:
    picture = textured(3)
    scene = ScenePicture(seen(picture, still(), 0))
    true = AffineMap(np.array([2.0, 0, 0.5, -1.0, -0.5, 0]), SIZE)
    image = seen(picture, true, 1)
    image[40:150, 60:150] = seen(textured(4), still(), 2)[40:150, 60:150]  # a quarter of the picture
    found = scene.register(image, still())
    assert AffineMap(found.map.parameters - true.parameters, SIZE).displacement < 0.1


LIGHTS: list[Callable[[Numbers], Numbers]] = [
    lambda x: 0.6 * x,
    lambda x: 1.4 * x + 10,
    lambda x: 255 * (x / 255) ** 1.7,
]


@pytest.mark.parametrize("change", LIGHTS)
def test_light_that_is_switched_is_no_motion(change: Callable[[Numbers], Numbers]) -> None:
    picture = textured(5)
    scene = ScenePicture(seen(picture, still(), 0))
    image = np.clip(change(seen(picture, still(), 1).astype(float)), 0, 255).astype(np.uint8)
    found = scene.register(image, still())
    assert found.map.displacement < 0.15
    assert found.explained < 0.2


def test_another_picture_is_not_explained_by_any_map() -> None:
    scene = ScenePicture(seen(textured(6), still(), 0))
    for seed in range(7, 12):
        found = scene.register(seen(textured(seed), still(), 1), still())
        assert max(found.explained, found.correlation) < 0.3


@pytest.mark.parametrize("size", [(2, 4000), (4000, 2), (8, 8), (20, 4000)])
def test_pictures_too_thin_to_be_registered_are_refused_in_one_line(size) -> None:
    with pytest.raises(ValueError, match=f"got pictures of {size[1]}x{size[0]} px"):
        ScenePicture(np.zeros(size, np.uint8))
