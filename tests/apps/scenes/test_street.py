"""The generated street: exact truth, the same bytes for the same seed, and events when they are due."""

import cv2
import numpy as np
import pytest
from rsmcm.apps.scenes import Scene, sleeping_man
from rsmcm.apps.scenes.street import CLOUD_SHADE, LIGHT_AFTER_JUMP

SMALL = (160, 120)


def quiet(n_frames: int = 400, **settings: int) -> Scene:
    """A scene without noise and drift, whose pixels change only where something moves."""
    return sleeping_man(n_frames, size=SMALL, noise=0, light_drift=0, **settings)


@pytest.mark.parametrize("index", [60, 150])
def test_mask_covers_what_differs_from_the_empty_street(index: int) -> None:
    scene = quiet(car_leaves=400)
    changed = np.any(scene[index].image != scene[0].image, axis=-1)
    mask = scene.foreground(index)
    assert mask.any()
    # outside the mask, only pixels of the outline, covered by half or less, may differ
    near = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert not (changed & ~near).any()
    # inside, a pixel keeps its colour only by chance
    assert (mask & ~changed).sum() < 0.01 * mask.sum()


def test_person_walks_in_stands_and_walks_out() -> None:
    scene = quiet()
    assert not scene.masks[0].any()
    inside = [bool(scene.person(index).any()) for index in range(0, 400, 5)]
    assert inside.index(True) * 5 in range(40, 60)
    assert not inside[-1]
    places = [scene.boxes(index)[-1].box for index in range(110, 300, 10)]
    assert np.ptp([left for left, *_ in places]) <= 4
    # swaying: consecutive standing masks differ a little, and by little
    differing = (scene.person(150) != scene.person(156)).sum()
    assert 0 < differing < 0.1 * scene.person(150).sum()


def test_parked_car_is_background_until_it_leaves() -> None:
    scene = quiet(car_leaves=20)
    assert scene.car(19).any()
    assert not scene.foreground(19).any()
    assert np.array_equal(scene.foreground(20), scene.car(20))
    assert [box.kind for box in scene.boxes(20)] == ["vehicle"]
    # once it has gone, the ground that it hid is background again
    assert not scene.foreground(39).all()
    assert not scene.car(120).any()
    uncovered = scene.car(0) & ~scene.person(120)
    assert not (scene.foreground(120) & uncovered).any()
    assert np.any(scene[120].image != scene[0].image, axis=-1)[uncovered].mean() > 0.9


def test_light_jumps_once() -> None:
    scene = sleeping_man(60, size=SMALL, light_jump=30, light_drift=0, noise=0, enter=60)
    before, after = scene[29].image, scene[30].image
    assert after.mean() / before.mean() == pytest.approx(LIGHT_AFTER_JUMP, abs=0.01)  # rounding
    assert np.array_equal(before, scene[0].image)


def test_clouds_darken_and_move() -> None:
    clear, cloudy = (sleeping_man(size=SMALL, noise=0, clouds=each) for each in (False, True))
    # four moments in which the clouds have moved by the picture's width: all of them
    shares = np.stack([cloudy[i].image / np.maximum(clear[i].image, 1.0) for i in (0, 100, 200, 300)])
    lit = np.stack([clear[i].image for i in (0, 100, 200, 300)]) > 80
    assert shares[lit].min() == pytest.approx(1 - CLOUD_SHADE, abs=0.03)
    assert shares.max() <= 1
    assert np.abs(shares[0] - shares[1])[lit[0] & lit[1]].max() > 0.2
