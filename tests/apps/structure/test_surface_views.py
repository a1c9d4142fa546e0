"""A frame laid over its points: unturned it is the frame; turned, a slope shows or hides."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.structure.reconstruction import Reconstruction
from rsmcm.apps.structure.surface_views import surface_views
from rsmcm.models.core.frame import Frame

from ...support.reconstructions import reconstruction, small_cylinder, without_images

WIDTH, HEIGHT = 120, 100
GRID = np.stack(np.meshgrid(np.arange(10, 111, 10.0), np.arange(10, 91, 10.0)), axis=-1).reshape(-1, 2)


def plane(slope: float) -> Reconstruction:
    """Points of a grid, deeper by `slope` for each px to the right, seen head-on in one frame."""
    camera = np.array([[[1.0, 0, 0, 0], [0, 1, 0, 0]]])
    n_points = len(GRID)
    return replace(
        reconstruction(small_cylinder()),
        positions=GRID[None],
        observed=np.ones((1, n_points), bool),
        residuals=np.zeros((1, n_points, 2)),
        cameras=camera,
        shape=np.column_stack([GRID, slope * GRID[:, 0]]),
        shape_covariances=np.tile(np.eye(3), (n_points, 1, 1)),
    )


def covered(view: NDArray[np.uint8]) -> int:
    return int(np.count_nonzero((view != 255).any(axis=2)))


IMAGE = np.random.default_rng(0).integers(0, 200, (HEIGHT, WIDTH, 3), dtype=np.uint8)
FRAMES = [Frame(IMAGE, 0.0, 1)]


def test_unturned_it_is_the_frame_itself() -> None:
    (view,) = surface_views(FRAMES, plane(0.3), [0])
    np.testing.assert_array_equal(view[12:89, 12:109], IMAGE[12:89, 12:109])
    assert (view[:8] == 255).all()


def test_turning_towards_and_away() -> None:
    views = surface_views(FRAMES, plane(0.5), [0, 30, -30])
    front, away, towards = (covered(view) for view in views)
    expected = [np.cos(np.radians(angle)) - 0.5 * np.sin(np.radians(angle)) for angle in (30, -30)]
    np.testing.assert_allclose([away / front, towards / front], expected, rtol=0.03)  # whole px of 100


def test_long_triangles_and_unsure_points_are_left_out() -> None:
    found = plane(0.0)
    covariances = found.shape_covariances.copy()
    covariances[GRID[:, 0] > 60] *= 100
    (view,) = surface_views(FRAMES, replace(found, shape_covariances=covariances), [0])
    assert (view[20:80, 65:] == 255).all()
    assert (view[20:80, 12:58] != 255).any(axis=2).all()


def test_nothing_to_show() -> None:
    assert surface_views(without_images(FRAMES), plane(0.0), [0]) == []
    hidden = replace(plane(0.0), observed=np.zeros((1, len(GRID)), bool))
    assert surface_views(FRAMES, hidden, [0]) == []


def test_grey_frames() -> None:
    (view,) = surface_views([Frame(IMAGE[:, :, 0].copy(), 0.0, 1)], plane(0.0), [0])
    assert view.shape == (HEIGHT, WIDTH, 3)
