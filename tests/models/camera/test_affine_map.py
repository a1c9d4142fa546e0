"""Affine maps: places, pictures, and what a px of a parameter is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.models.camera.moving_camera import AffineMap

SIZE = (60, 90)


def numbers(largest: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(-largest, largest), min_size=6, max_size=6).map(np.array)


@given(numbers(5.0))
def test_no_parameter_moves_a_place_of_the_picture_by_more_than_itself(parameters: np.ndarray) -> None:
    corners = np.array([(x, y) for x in (0, SIZE[1] - 1) for y in (0, SIZE[0] - 1)], float)
    for k in range(6):
        alone = np.where(np.arange(6) == k, parameters, 0.0)
        moved = np.hypot(*(AffineMap(alone, SIZE).points(corners) - corners).T)
        assert (moved <= abs(parameters[k]) + 1e-9).all()


@given(numbers(5.0))
def test_displacement_is_the_root_mean_square_over_the_picture(parameters: np.ndarray) -> None:
    view = AffineMap(parameters, SIZE)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    places = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)
    mean_square = ((view.points(places) - places) ** 2).sum(axis=1).mean()
    assert view.displacement == pytest.approx(np.sqrt(mean_square), rel=0.03, abs=1e-9)


def test_a_frame_comes_back_to_the_scene_and_the_mask_to_the_frame() -> None:
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    ramp = np.asarray(2 * columns + rows, np.uint8)  # bends nowhere, so that interpolation is exact
    view = AffineMap(np.array([3.0, 0, 0, -2.0, 0, 0]), SIZE)
    frame = np.asarray(2 * (columns - 3) + (rows + 2), np.int16).clip(0, 255).astype(np.uint8)
    scene = view.warp_to_scene(frame, np.full(SIZE, 7, np.uint8))
    assert (scene[3:-3, 3:-4] == ramp[3:-3, 3:-4]).all()
    assert (scene[:1] == 7).all(), "the frame does not show it"
    assert (scene[:, -2:] == 7).all()
    mask = np.zeros(SIZE, np.uint8)
    mask[20:30, 40:50] = 255
    seen = view.warp_to_frame(mask)
    assert (seen[18:28, 43:53] == 255).all()
    assert seen.sum() == mask.sum()


def test_a_box_is_where_its_corners_are() -> None:
    shift = AffineMap(np.array([3.5, 0, 0, -2.0, 0, 0]), SIZE)
    assert shift.box((10, 20, 8, 16)) == pytest.approx((13.5, 18, 8, 16))
    radius = shift.radius
    zoom = AffineMap(np.array([0, 0.1 * radius, 0, 0, 0, 0.1 * radius]), SIZE)
    corners = zoom.points(np.array([(9.5, 19.5), (17.5, 35.5)])) + 0.5
    x, y, width, height = zoom.box((10, 20, 8, 16))
    assert np.allclose([(x, y), (x + width, y + height)], corners)
