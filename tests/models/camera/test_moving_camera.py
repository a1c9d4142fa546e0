"""Affine maps, and registration of frames against maps that are known."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.camera.moving_camera import AffineMap, ScenePicture, View
from scipy.ndimage import affine_transform

SMALL = (60, 90)


def numbers(largest: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(-largest, largest), min_size=6, max_size=6).map(np.array)


@given(numbers(5.0))
def test_displacement_is_the_root_mean_square_over_the_picture(parameters: np.ndarray) -> None:
    view = AffineMap(parameters, SMALL)
    rows, columns = np.mgrid[: SMALL[0], : SMALL[1]]
    places = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)
    mean_square = ((view.points(places) - places) ** 2).sum(axis=1).mean()
    assert view.displacement == pytest.approx(np.sqrt(mean_square), rel=0.03, abs=1e-9)


def test_a_frame_comes_back_to_the_scene_and_the_mask_to_the_frame() -> None:
    rows, columns = np.mgrid[: SMALL[0], : SMALL[1]]
    ramp = np.asarray(2 * columns + rows, np.uint8)  # bends nowhere, so that interpolation is exact
    view = AffineMap(np.array([3.0, 0, 0, -2.0, 0, 0]), SMALL)
    frame = np.asarray(2 * (columns - 3) + (rows + 2), np.int16).clip(0, 255).astype(np.uint8)
    scene = view.warp_to_scene(frame, np.full(SMALL, 7, np.uint8))
    assert (scene[3:-3, 3:-4] == ramp[3:-3, 3:-4]).all()
    assert (scene[:1] == 7).all(), "the frame does not show it"
    assert (scene[:, -2:] == 7).all()
    mask = np.zeros(SMALL, np.uint8)
    mask[20:30, 40:50] = 255
    seen = view.warp_to_frame(mask)
    assert (seen[18:28, 43:53] == 255).all()
    assert seen.sum() == mask.sum()


def test_a_box_is_where_its_corners_are() -> None:
    shift = AffineMap(np.array([3.5, 0, 0, -2.0, 0, 0]), SMALL)
    box = np.array([[14.0, 36, 8, 16]])  # middle of the lowest edge, width, height
    np.testing.assert_allclose(shift.boxes(box), [[17.5, 34, 8, 16]])
    radius = shift.radius
    zoom = AffineMap(np.array([0, 0.1 * radius, 0, 0, 0, 0.1 * radius]), SMALL)
    corners = zoom.points(np.array([(9.5, 19.5), (17.5, 35.5)])) + 0.5
    ((x, y, width, height),) = zoom.boxes(box)
    assert np.allclose([(x - width / 2, y - height), (x + width / 2, y)], corners)


@given(numbers(5.0), numbers(5.0))
def test_maps_one_after_the_other_and_back(first: np.ndarray, second: np.ndarray) -> None:
    one, two = AffineMap(first, SMALL), AffineMap(second, SMALL)
    places = np.array([[0.0, 0.0], [80.0, 10.0], [30.0, 55.0]])
    np.testing.assert_allclose(two.after(one).points(places), two.points(one.points(places)), atol=1e-9)
    np.testing.assert_allclose(one.inverse.points(one.points(places)), places, atol=1e-9)


def test_what_the_map_is_unsure_of_moves_boxes_as_much_as_is_said() -> None:
    random = np.random.default_rng(0)
    spread = random.normal(size=(6, 6))
    covariance = 0.05 * spread @ spread.T
    view = View.predicted(random.normal(size=6), covariance, np.zeros(SMALL, np.float32))
    boxes = np.array([[14.0, 36, 8, 16], [70.0, 58, 20, 50]])
    drawn = random.multivariate_normal(view.map.parameters, covariance, 20_000)
    seen = np.stack([AffineMap(each, SMALL).boxes(boxes) for each in drawn])
    # a variance of n draws is known to sqrt(2 / n); shear, which turns middles of edges, is left out
    np.testing.assert_allclose(
        view.box_variances(boxes), seen.var(axis=0), rtol=5 * np.sqrt(2 / 20_000), atol=0.02
    )


SIZE = (180, 240)
Image = NDArray[np.uint8]
Array = NDArray[np.float64]


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
def test_a_known_map_is_found_to_a_twentieth_of_a_pixel(amount: float) -> None:
    picture = textured(1)
    scene = ScenePicture(seen(picture, still(), 0))
    for seed in range(5):
        share = np.array([1, 0.25, 0.25, 1, 0.25, 0.25])
        true = np.random.default_rng(seed).normal(0, amount, 6) * share
        found = scene.register(seen(picture, AffineMap(true, SIZE), seed + 1), still())
        assert AffineMap(found.map.parameters - true, SIZE).displacement < 0.05
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


LIGHTS: list[Callable[[Array], Array]] = [
    lambda x: 0.6 * x,
    lambda x: 1.4 * x + 10,
    lambda x: 255 * (x / 255) ** 1.7,
]


@pytest.mark.parametrize("change", LIGHTS)
def test_light_that_is_switched_is_no_motion(change: Callable[[Array], Array]) -> None:
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
