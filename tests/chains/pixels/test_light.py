"""The light of a frame: interpolated, measured, and followed behind what stands before the scene."""

import cv2
import numpy as np
import pytest
from rsmcm.chains.pixels.background_prediction import fixed_point
from rsmcm.chains.pixels.light import (
    LUMA_NOISE,
    LightField,
    light_grid,
    light_ratios,
    share_of_blocks,
    track_light,
)
from rsmcm.models.pixels import colour
from scipy.stats import norm

from ...support.light import light_of

SIZE = (120, 160)


def stored(image):
    """Means of a scene that looks like this, as they are stored."""
    planes = colour.to_planes(image)
    return fixed_point(planes, planes[0], planes[0]).mean


@pytest.mark.parametrize("size", [(23, 37), (2, 2), (5, 1000)])
def test_light_is_interpolated_between_block_centres(size):
    blocks = np.random.default_rng(9).uniform(0.5, 2, (3, 4)).astype(np.float32)
    field = LightField(blocks, size)
    rows, position = field.along_rows
    above = position.astype(int)
    share = (position - above)[:, None]
    light = rows[above] * (1 - share) + rows[above + 1] * share
    assert light.shape == size
    np.testing.assert_allclose(light.reshape(-1), light_of(field), rtol=1e-5)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_blocks_light_is_a_median_of_samples(channels):
    rng = np.random.default_rng(3)
    shape = (61, 83) if channels == 1 else (61, 83, 3)
    image = rng.integers(30, 250, shape).astype(np.uint8)
    mean = stored(np.clip(image / 1.2 + rng.normal(0, 6, shape), 0, 255).astype(np.uint8))
    field = LightField(rng.uniform(0.8, 1.2, (3, 4)).astype(np.float32), (61, 83))
    image[:20, :20] = 255  # nothing to be learned from saturated pixels
    ratios, agreement, texture = (np.empty((3, 4), np.float32) for _ in range(3))
    light_ratios(0, len(field.blocks), image.reshape(-1), mean, field.along_rows, ratios, agreement, texture)
    luma = colour.to_planes(image)[0].reshape(61, 83)
    expected = (light_of(field) * mean[0] / 32).reshape(61, 83)
    for row in range(3):
        for column in range(4):
            ys = [int((6 * row + k + 0.5) * 61 / 18) for k in range(6)]
            xs = [int((6 * column + k + 0.5) * 83 / 24) for k in range(6)]
            seen, told = luma[np.ix_(ys, xs)].ravel(), expected[np.ix_(ys, xs)].ravel()
            usable = (told > 16) & (seen > 2) & (seen < 250)
            values = np.sort(seen[usable] / told[usable])
            if len(values) < 12:
                assert (ratios[row, column], agreement[row, column], texture[row, column]) == (1, 0, 0)
                continue
            median = values[len(values) // 2]
            assert ratios[row, column] == pytest.approx(median, rel=1e-5)
            seen, told = seen[usable], told[usable]
            spreads = np.var(seen) + LUMA_NOISE, np.mean((seen - median * told) ** 2) + LUMA_NOISE
            nats = sum(
                sign * norm.logpdf(0, 0, np.sqrt(spread))
                for sign, spread in zip((-1, 1), spreads, strict=True)
            )
            assert texture[row, column] == pytest.approx(len(seen) * nats, rel=1e-3, abs=0.01)
            close = np.abs(values / median - 1)
            bounds = (close < 0.0499).mean() - 1e-6, (close < 0.0501).mean() + 1e-6
            assert bounds[0] <= agreement[row, column] <= bounds[1]
    assert agreement.max() > 0
    assert agreement[0, 0] == 0


def room(texture):
    """A wall of `texture` grey levels, and where somebody stands before it."""
    wall = 130 + np.random.default_rng(4).normal(0, max(texture, 1e-3), SIZE)
    covered = np.zeros(SIZE, np.uint8)
    covered[35:115, 60:100] = 255
    return wall, covered


def light_after(frames, wall, covered, dt=0.04):
    """Blocks of light after some frames, float64 pictures that noise is added to."""
    rng = np.random.default_rng(5)
    grid = light_grid(*SIZE)
    light, mean = (
        LightField(np.ones(grid, np.float32), SIZE),
        stored(np.rint(wall).astype(np.uint8)),
    )
    shares = share_of_blocks(covered, grid)
    for frame in frames:
        image = np.clip(np.rint(frame + rng.normal(0, 3, SIZE)), 0, 255).astype(np.uint8)
        light = track_light(light, image, mean, shares, dt)
    return light.blocks, shares


@pytest.mark.parametrize(("texture", "lamp"), [(0, 0.7), (12, 1.0)])
def test_a_person_who_stays_is_not_taken_for_shade(texture, lamp):
    wall, covered = room(texture)
    person = 60 + np.random.default_rng(6).normal(0, 4, SIZE)
    seen = lamp * np.where(covered > 0, person, wall)
    blocks, shares = light_after([seen] * 100, wall, covered)
    assert (shares == 1).sum() > 50
    np.testing.assert_allclose(blocks, lamp, atol=0.03)


@pytest.mark.parametrize("dt", [0.02, 0.08])
def test_shade_on_what_is_wrongly_taken_for_an_object_is_followed_by_its_texture(dt):
    wall, covered = room(16)
    shade = cv2.GaussianBlur(np.where(covered > 0, 0.7, 1.0), (0, 0), 8)
    frames = [wall * shade ** min(k * dt, 1) for k in range(round(2 / dt))]
    blocks, _ = light_after(frames, wall, covered, dt)
    light = light_of(LightField(blocks, SIZE)).reshape(SIZE)
    assert np.quantile(np.abs(light - shade), 0.95) < 0.06


def test_a_shade_that_enters_the_picture_is_followed_up_to_the_border():
    wall, covered = room(10)
    slopes = [0.9 - 0.002 * k - 0.0015 * np.arange(160) for k in range(60)]
    blocks, _ = light_after([wall * slope for slope in slopes], wall, np.zeros_like(covered))
    field = LightField(blocks, SIZE)
    light = light_of(field).reshape(SIZE)
    error = np.abs(light[:, [0, 159]] - slopes[-1][[0, 159]])  # corners are extrapolated both ways
    assert np.quantile(error, 0.9) < 0.03


def test_light_that_went_wrong_behind_an_object_comes_back_to_that_around_it():
    wall, covered = room(0)
    grid = light_grid(*SIZE)
    shares = share_of_blocks(covered, grid)
    light = LightField(np.where(shares > 0.5, 0.3, 1).astype(np.float32), SIZE)
    mean = stored(np.rint(wall).astype(np.uint8))
    image = np.where(covered > 0, 60, wall).astype(np.uint8)
    for _ in range(250):
        light = track_light(light, image, mean, shares, 0.04)
    np.testing.assert_allclose(light.blocks, 1, atol=0.05)
