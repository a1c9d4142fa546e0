"""Scenes that move to and fro: rates are learned of leaves, not of shade, and not of people."""

import cv2
import numpy as np
import pytest
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.chains.pixels.background_prediction import fixed_point, log_prior_odds, stored_planes
from rsmcm.chains.pixels.gaussians import PixelModel
from rsmcm.chains.pixels.light import LightField
from rsmcm.chains.pixels.sway import LEAST_RATE, Sway, recall_moved, sway_reach, update_rates
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels
from rsmcm.models.pixels import colour

SIZE = (60, 80)
GRID = (3, 4)


def scene(seed=0):
    """Leaves: spots of a few px, `(60, 80, 3)` uint8."""
    noise = np.random.default_rng(seed).normal(0, 1, (*SIZE, 3))
    spots = np.dstack([cv2.GaussianBlur(plane, (0, 0), 1.5) for plane in np.moveaxis(noise, -1, 0)])
    return np.clip(120 + 40 * spots / spots.std(), 0, 255).astype(np.uint8)


def known(image):
    flat = np.full(image.shape[0] * image.shape[1], 1, np.float32)
    return fixed_point(colour.to_planes(image), flat, 30 * flat)


def light():
    return LightField(np.ones(GRID, np.float32), SIZE).along_rows


def rates_after(images, covered=None, seconds=5.0, dt=0.04):
    sway, age = Sway(np.zeros(GRID, np.float32), sway_reach(SIZE)), 0.0
    covered = np.zeros(SIZE, np.uint8) if covered is None else covered
    unsure = np.zeros(covered.size, np.int8)
    for k in range(round(seconds / dt)):
        rates = update_rates(
            sway, images[k % len(images)].ravel(), known(images[0]), light(), unsure, covered.ravel(), age, dt
        )
        sway, age = Sway(rates, sway.reach), age + dt
    return sway.rates


def test_leaves_sway_and_shade_and_people_do_not():
    still = scene()
    leaves = [np.roll(still, (down, right), (0, 1)) for down, right in ((0, 0), (2, 1), (-1, 3), (1, -2))]
    assert rates_after(leaves).min() > 0.1
    assert rates_after([still]).max() < LEAST_RATE / 4
    shade = [np.clip(still * share, 0, 255).astype(np.uint8) for share in (1, 0.7, 0.8)]
    assert rates_after(shade).max() < 2 * LEAST_RATE
    person = still.copy()
    person[10:50, 30:44] = (200, 30, 30)
    assert rates_after([person if k % 5 else still for k in range(10)]).max() < LEAST_RATE


def test_what_passes_by_does_not_sway_though_a_third_of_it_looks_like_something_nearby():
    """The odds of a count above zero are those of four standard deviations of 192 sampled pixels."""
    still, rng = scene(), np.random.default_rng(2)
    passing = []
    for _ in range(10):
        strange = rng.integers(0, 256, still.shape).astype(np.uint8)
        nearby = np.roll(still, (2, -1), (0, 1))
        passing.append(np.where(rng.random((*SIZE, 1)) < 0.35, nearby, strange))
    assert rates_after(passing).max() < LEAST_RATE / 4


def test_what_is_covered_is_not_learned_from_and_what_is_not_seen_is_kept():
    still = scene()
    covered = np.zeros(SIZE, np.uint8)
    covered[:, :60] = 255
    rates = rates_after([still, np.roll(still, 3, 1)], covered)
    assert (rates[:, :2] == 0).all()
    assert rates[:, 3].min() > 0.1


@pytest.mark.parametrize("dt", [0.02, 0.08])
def test_rates_do_not_depend_on_the_frame_rate(dt):
    still = scene()
    films = [still, np.roll(still, 2, 0)]
    np.testing.assert_allclose(rates_after(films, dt=dt), rates_after(films, dt=0.04), rtol=0.1)


def test_the_likelihood_is_that_of_the_best_place_within_reach():
    still, rng = scene(), np.random.default_rng(1)
    image = rng.integers(0, 256, still.shape).astype(np.uint8)
    image[:30] = np.roll(still, (2, -3), (0, 1))[:30]
    rates = rng.uniform(0.05, 0.5, GRID).astype(np.float32)
    rates[2, 3] = LEAST_RATE / 2
    before, prior = known(still), log_prior_odds(0.95, 3)
    model = PixelModel(*map(np.float32, (prior, 2.9, 1, 0, 20, 0)))
    odds = np.where(rng.random(4800) < 0.5, -100, 50).astype(np.int8)
    after = odds.copy()
    recall_moved(0, image.reshape(-1), before, light(), model, Sway(rates, 3), after)
    shown, mean = colour.to_planes(image).reshape(3, *SIZE), stored_planes(before.mean, SIZE).grey_levels()
    padded = np.pad(mean, ((0, 0), (3, 3), (3, 3)), constant_values=1e6)
    gaps = [
        ((shown - padded[:, y : y + 60, x : x + 80]) ** 2).sum(axis=0) for y in range(7) for x in range(7)
    ]
    rate = np.kron(rates, np.ones((20, 20)))
    found = prior + np.log(rate) - 0.5 * (3 * np.log(31) + np.min(gaps, axis=0) / 31)
    expected = np.maximum(odds, np.trunc(20 * np.clip(found, -6, 5.95)).ravel())
    expected = np.where((odds < 0) & (rate.ravel() >= LEAST_RATE), expected, odds)
    assert np.abs(after - expected).max() <= 1
    assert (after[:2400] > odds[:2400]).mean() > 0.4


def swaying_leaves(seed, count=250, arrives=200):
    """Frames of leaves that sway in three smooth fields at .5 to 1.7 Hz; at last somebody passes them by."""
    wide = np.hstack([scene(1000 * seed + side) for side in range(2)])
    rng, (rows, columns) = np.random.default_rng(seed), np.mgrid[:60, :160].astype(np.float32)
    fields = [cv2.GaussianBlur(rng.normal(0, 1, (60, 160)), (0, 0), 12) for _ in range(6)]
    fields = np.array([field / field.std() for field in fields])
    for k in range(count):
        turns = np.sin(2 * np.pi * 0.04 * k * np.array([0.7, 1.1, 1.7, 0.5, 0.9, 1.3]) + np.arange(6))
        right, down = (np.tensordot(turns[part], fields[part], 1) for part in (slice(3), slice(3, 6)))
        at = (columns + right).astype(np.float32), (rows + down).astype(np.float32)
        image = cv2.remap(wide, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        if k >= arrives:
            image[10:50, 3 * (k - arrives) : 3 * (k - arrives) + 14] = 235, 60, 50
        yield np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.slow
def test_while_only_leaves_move_two_percent_is_foreground_and_a_person_is_seen():
    shares, found = [], []
    for seed in range(20):
        pixels = PixelLabels()
        model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
        beliefs = RecursiveBP(model).run(swaying_leaves(seed), dt=0.04)
        masks = [belief[pixels].foreground() > 0 for belief in beliefs]
        shares.append(np.mean(masks[75:200]))
        found.append(np.mean([masks[200 + k][10:50, 3 * k : 3 * k + 14] for k in range(20, 48)]))
    assert np.mean(shares) + np.std(shares) / np.sqrt(20) < 0.02
    assert min(found) > 0.9
