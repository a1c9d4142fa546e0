"""What stands in a scene and what has gone from it: told apart by outlines in image and picture."""

import numpy as np
import pytest
from rsmcm.inference.objects import ghosts
from rsmcm.models.objects.kernels.blobs import Patch

F4 = np.float32
SIZE = (60, 50)
OBJECT = np.s_[14:44, 18:32]


def pair(seed, contrast, noise, texture=6.0):
    """An empty scene as it is remembered, and the same with an object and noise; three planes each."""
    random = np.random.default_rng(seed)
    coarse = random.normal(0, texture, (3, SIZE[0] // 3 + 1, SIZE[1] // 3 + 1))
    scene = 110 + coarse.repeat(3, axis=1).repeat(3, axis=2)[:, : SIZE[0], : SIZE[1]]
    shown = scene.copy()
    shown[:, *OBJECT] = 110 + contrast * np.array([1, 0.5, -0.5])[:, None, None]
    shown += random.normal(0, noise, shown.shape)
    return scene.astype(F4), shown.astype(F4)


def patch(planes):
    return Patch(planes, np.zeros(SIZE, F4), np.ones(SIZE, F4))


def outline():
    mask = np.zeros(SIZE, F4)
    mask[OBJECT] = 0.9
    return mask


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0, 4, 10])
def test_a_thing_before_the_scene_is_real_and_one_in_the_picture_is_a_ghost(seed, noise):
    empty, with_object = pair(seed, 60, noise)
    assert ghosts.outline_evidence(patch(with_object), empty, outline()) < -60
    noisy = empty + np.random.default_rng(9).normal(0, noise, empty.shape).astype(F4)
    assert ghosts.outline_evidence(patch(noisy), pair(seed, 60, 0)[1], outline()) > 60


@pytest.mark.parametrize("noise", [0, 4, 10])
def test_without_contrast_on_either_side_nothing_is_said(noise):
    """Neither the noise of the image, which the picture does not have, nor texture is an edge."""
    found = []
    for seed in range(40):
        scene, _ = pair(seed, 0, 0)
        image = scene + np.random.default_rng([seed, 1]).normal(0, noise, scene.shape).astype(F4)
        found.append(ghosts.outline_evidence(patch(image), scene, outline()))
    assert abs(np.mean(found)) < 3
    assert np.abs(found).max() < 30


def test_the_ratio_turns_round_with_image_and_picture():
    empty, with_object = pair(3, 40, 0)
    there = ghosts.outline_evidence(patch(with_object), empty, outline())
    assert ghosts.outline_evidence(patch(empty), with_object, outline()) == pytest.approx(-there)


def test_an_outline_that_others_hide_tells_nothing():
    empty, with_object = pair(3, 40, 0)
    hidden = patch(with_object)._replace(free=np.zeros(SIZE, F4))
    assert ghosts.outline_evidence(hidden, empty, outline()) == 0
