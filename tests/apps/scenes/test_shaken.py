"""Films of a camera that shakes."""

import cv2
import numpy as np
import pytest
from rsmcm.apps.scenes import shaken, sleeping_man


def test_frames_show_the_scene_where_the_maps_say() -> None:
    scene = sleeping_man(12, size=(160, 120), enter=0, noise=0.0, light_drift=0.0)
    film = shaken(scene, 2.0, seed=1, margin=12)
    assert film.size == (136, 96)
    first = film[0].image
    assert first is not None
    assert (first == scene[0].image[12:-12, 12:-12]).all(), "the first frame is as it was"
    index = int(np.argmax([np.abs(view.parameters).max() for view in film.views]))
    steady, image = scene[index].image[12:-12, 12:-12], film[index].image
    back = film.views[index].warp_to_scene(image, np.zeros_like(image))
    # details that cannot be interpolated are left out
    steady, image, back = (
        cv2.GaussianBlur(each, (0, 0), 2.0).astype(float) for each in (steady, image, back)
    )
    inner = (slice(15, -15), slice(15, -15))
    moved = np.abs(image[inner] - steady[inner]).mean()
    assert np.abs(back[inner] - steady[inner]).mean() < 0.1 * moved


def test_shake_is_as_large_as_asked_and_the_same_at_any_rate() -> None:
    amounts = []
    for step in (1, 2):
        film = shaken(sleeping_man(400, size=(64, 48))[::step], 3.0, margin=8)
        parameters = np.stack([view.parameters for view in film.views])
        amounts.append(parameters.std(axis=0))
        change = np.diff(parameters[:: 2 // step, 0]).std()
        assert change == pytest.approx(3.0 * np.sqrt(2 * (1 - np.exp(-0.08 / 0.15))), rel=0.25)
    for amount in amounts:
        assert amount == pytest.approx(3.0 * np.array([1, 0.25, 0.25, 1, 0.25, 0.25]), rel=0.3)
