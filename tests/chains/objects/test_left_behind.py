"""What somebody leaves standing, in small films with known masks."""

import numpy as np
import pytest
from rsmcm.chains.objects.blobs import Blob, Blobs
from rsmcm.chains.objects.left_behind import PATIENCE, STAYS, LeftBehind

from .test_blob_tracker import BLUE, DT, GROUND, SIZE, TALL, run, texture

BAG = np.s_[74:90, 84:100]
DARKER = tuple(level - 28 for level in GROUND)
COLD, WARM = 100, 120  # grey levels of the ground and of what is left on it
STEP = 0.1  # s


def pictures(seed, stays):
    """Somebody brings a bag 28 grey levels darker than the ground and leaves it, or takes it along."""
    random = np.random.default_rng(seed)
    scene, man, bag = (
        texture(1000 * seed + k, *thing)
        for k, thing in enumerate(((SIZE, GROUND, 10), (TALL, BLUE, 25), ((16, 16), DARKER, 3)))
    )
    images = []
    for number in range(170):
        time, image = number * DT, scene.copy()
        there = 70 - 45 * max(2 - time, 0)
        left = there - 45 * max(time - 3.5, 0)
        for thing, top, x in ((man, 50, left), (bag, 74, (there if stays else left) + 14)):
            height, width = thing.shape[:2]
            first, end = max(round(x), 0), max(round(x) + width, 0)
            image[top : top + height, first:end] = thing[:, width - (end - first) :]
        images.append(np.clip(image + random.normal(0, 2, image.shape), 0, 255).astype(np.uint8))
    return images


def bare(ground):
    """What is known where no object has been yet."""
    known, nobody = LeftBehind.nothing(ground), Blobs.none(1)
    for _ in range(round(STAYS / STEP) + 1):
        known = known.after(ground, nobody, np.zeros(0, bool), nobody, 20.0, STEP)
    return known


def test_what_hardly_differs_is_seen_after_its_owner_has_left():
    """Mean recall over seeds, and less than 10 % where he takes it along."""
    shares = {
        stays: [(run(pictures(seed, stays))[-1]["pixels"].foreground()[BAG] > 0).mean() for seed in range(3)]
        for stays in (True, False)
    }
    assert np.mean(shares[True]) > 0.6, shares
    assert np.mean(shares[False]) < 0.1, shares


@pytest.mark.parametrize("remains", [True, False])
def test_a_part_that_stays_is_left_behind_until_it_shows_the_ground_again(remains):
    ground, seen = np.full((40, 40, 1), COLD, np.uint8), np.full((40, 40, 1), COLD, np.uint8)
    seen[10:30, 10:30] = WARM
    nobody, patch = Blobs.none(1), np.zeros((40, 40), np.float32)
    patch[10:30, 10:30] = 0.9
    owner = Blobs.of([Blob.newborn(1, np.zeros(2), patch, patch[None], 1.0, 100.0)], 1)
    known = bare(ground).after(seen, owner, np.ones(1, bool), nobody, 20.0, STEP)
    for _ in range(round(STAYS / STEP) + 1):
        known = known.after(seen if remains else ground, nobody, np.zeros(0, bool), nobody, 20.0, STEP)
    np.testing.assert_array_equal(known.parts, remains * (patch > 0))
    for _ in range(round(PATIENCE / STEP) + 2):
        known = known.after(ground, nobody, np.zeros(0, bool), nobody, 20.0, STEP)
    assert not known.parts.any()
    assert not len(known.layers())


def test_where_a_ghost_was_nothing_is_left_behind():
    ground = np.full((40, 40, 1), COLD, np.uint8)
    seen = ground + np.uint8(WARM - COLD)
    patch = np.full((40, 40), 0.9, np.float32)
    ghost = Blobs.of([Blob.newborn(1, np.zeros(2), patch, patch[None], 1.0, 100.0)], 1)
    known = bare(ground)
    for _ in range(20):
        known = known.after(seen, ghost, np.ones(1, bool), ghost, 20.0, STEP)
    assert not known.time.any()
    np.testing.assert_array_equal(known.before, seen)


def test_nothing_is_left_behind_where_the_scene_was_not_seen_for_long():
    """An object of the first frame is no scene: what is behind it, and stays, is not left by another."""
    ground = np.full((40, 40, 1), COLD, np.uint8)
    patch = np.full((40, 40), 0.9, np.float32)
    owner = Blobs.of([Blob.newborn(1, np.zeros(2), patch, patch[None], 1.0, 100.0)], 1)
    known, nobody = LeftBehind.nothing(ground + np.uint8(WARM - COLD)), Blobs.none(1)
    known = known.after(ground, owner, np.ones(1, bool), nobody, 20.0, STEP)
    for _ in range(20):
        known = known.after(ground, nobody, np.zeros(0, bool), nobody, 20.0, STEP)
    assert not known.parts.any()
