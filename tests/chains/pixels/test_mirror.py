"""Reflections: axes and shares that are known, plain loops, and rooms in which somebody stands."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.compare import Model
from rsmcm.apps.scenes import glossy
from rsmcm.chains.pixels import mirror
from rsmcm.chains.pixels.background_prediction import fixed_point
from rsmcm.chains.pixels.gaussians import ODDS_STEPS, Gaussians, PixelModel
from rsmcm.chains.pixels.light import LightField
from rsmcm.models.pixels import colour

SIZE = (72, 96)
AXIS = 41  # twice 20.5
MODEL = PixelModel(*np.float32([19.5, 2.9, 1.0, 0.0, 20.0, 0.0]))
LIGHT = LightField(np.ones((18, 24), np.float32), SIZE).along_rows

Prediction = tuple[Gaussians, NDArray[np.uint8], NDArray[np.int8]]


def mirrored(seed: int, share: float) -> Prediction:
    """An object of 12 rows of its own colours, and a share of it upside down below."""
    random = np.random.default_rng(seed)
    empty = np.full((*SIZE, 3), 150.0)
    image = empty + random.normal(0, 3, empty.shape)
    colours = np.repeat(random.uniform(-90, 90, (6, 1, 3)), 2, axis=0) + random.normal(0, 6, (12, 16, 3))
    image[8:20, 40:56] += colours
    image[22:34, 40:56] += share * colours[::-1]
    odds = np.full(SIZE, 120, np.int8)
    odds[8:20, 40:56] = odds[22:34, 40:56] = -100
    flat = np.ones(SIZE[0] * SIZE[1], np.float32)
    pixels = fixed_point(colour.to_planes(empty.astype(np.uint8)), 2 * flat, 20 * flat)
    return pixels, np.clip(np.rint(image), 0, 255).astype(np.uint8), odds


def axes_of(prediction: Prediction) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    pixels, image, odds = prediction
    axes, shares, seen = np.empty(24, np.int64), np.zeros(24, np.float32), np.zeros((2, 24), np.float32)
    everywhere = np.ones(24, bool)
    mirror.find_axes(
        image.reshape(-1), pixels, LIGHT, MODEL, odds.reshape(-1), everywhere, axes, shares, seen
    )
    return axes, shares, seen


@pytest.mark.parametrize("share", [0.2, 0.3, 0.5])
@pytest.mark.parametrize("seed", range(4))
def test_axis_and_share_are_found(seed: int, share: float) -> None:
    axes, shares, seen = axes_of(mirrored(seed, share))
    at = slice(10, 14)  # the columns of blocks that the object fills
    assert (axes[at] == AXIS).all()
    np.testing.assert_allclose(shares[at], share, atol=0.11)
    assert seen[:, at].all()
    assert not seen[:, :8].any()
    assert not seen[:, 16:].any()


@pytest.mark.parametrize("seed", range(8))
def test_an_object_that_goes_on_and_other_colours_are_no_reflection(seed: int) -> None:
    pixels, image, odds = mirrored(seed, 1.0)
    assert (axes_of((pixels, image, odds))[0] == -1).all()
    below = image[22:34, 40:56]
    below[:] = np.random.default_rng(100 + seed).integers(0, 255, (12, 16, 3))
    axes, _, seen = axes_of((pixels, image, odds))
    assert (axes == -1).all()
    assert seen[0, 10:14].all()


def test_odds_of_a_reflection_are_those_of_plain_loops() -> None:
    pixels, image, odds = mirrored(7, 0.4)
    axes, shares = np.full(24, AXIS), np.full(24, np.float32(0.4))
    axes[12:] = -1
    after, marks = odds.copy().reshape(-1), np.zeros(odds.size, np.uint8)
    mirror.recall_mirrored(image.reshape(-1), pixels, LIGHT, MODEL, axes, shares, after, marks)
    difference = (colour.to_planes(image) - pixels.mean / 32).reshape(3, *SIZE)
    expected = odds.astype(float)
    for y, x in zip(*np.nonzero(odds < 0), strict=True):
        up = AXIS - y
        if x >= 48 or not 0 <= up < y or odds[up, x] >= 0:
            continue
        variance = 20 + 120 * 0.4**2
        gap = ((difference[:, y, x] - 0.4 * difference[:, up, x]) ** 2).sum()
        ratio = 16.6 - 1.5 * np.log(variance) - 0.5 * gap / variance + 2.9
        if ratio > 0:
            expected[y, x] = ODDS_STEPS * min(ratio, 5.95)
    np.testing.assert_allclose(after.reshape(SIZE), expected, atol=1.01)
    assert ((marks == 255).reshape(SIZE) == (expected != odds)).all()
    assert (after.reshape(SIZE)[22:34, 40:48] > 0).mean() > 0.95
    assert (after.reshape(SIZE)[8:20] == odds[8:20]).all()


def test_columns_mirror_that_mostly_did_so_and_others_as_the_film() -> None:
    seen = np.zeros((2, 24), np.float32)
    assert not mirror.mirroring(seen).any()
    now = np.zeros_like(seen)
    now[0, :8], now[1, :4] = 1, 1
    for _ in range(2000):
        seen = mirror.update_mirror(seen, now, 100.0, 0.04)
    np.testing.assert_allclose(seen, now, atol=1e-3)
    assert mirror.mirroring(seen).tolist() == [True] * 4 + [False] * 20, "four of eight and one are no half"
    now[1, :8] = 1
    seen = mirror.update_mirror(seen, now, 100.0, 1e6)
    assert mirror.mirroring(seen).all()
    halved = mirror.update_mirror(seen, 0 * now, 1e6, (1 + mirror.MIRROR_TIME) * np.log(2))
    np.testing.assert_allclose(halved, seen / 2, rtol=1e-5)


@pytest.mark.parametrize(("seed", "table"), [(0, False), (1, True), (2, False), (3, True)])
def test_a_reflection_belongs_to_nobody(seed: int, table: bool) -> None:
    """Of half a second on; without reflections as an explanation, .5 to 1 of them is foreground."""
    room = glossy(75, seed, (160, 120), enter=0, share=0.5, table=table, noise=3.0, light_drift=0.0)
    model, shares = Model("room", "recursive-bp", room.size), []
    for index, frame in enumerate(room):
        found = model.step(frame).foreground > 0
        if index >= 30:
            shares.append([found[part].mean() for part in (room.person(index), room.reflection(index))])
    person, reflection = np.mean(shares, axis=0)
    assert person > 0.97
    assert reflection < 0.3


def test_the_background_learns_no_reflection() -> None:
    """Somebody stands on a floor that mirrors half of him, and has left at the end; over four seeds."""
    errors = []
    for seed in range(4):
        room = glossy(120, seed, (160, 120), enter=15, stand=40, share=0.5, noise=3.0, light_drift=0.0)
        model = Model("room", "recursive-bp", room.size)
        reflected, empty = np.zeros(room.size[::-1], bool), None
        for index, frame in enumerate(room):
            model.step(frame)
            reflected |= room.reflection(index)
            if index == 10:
                empty = model.background().astype(float)
        assert empty is not None
        errors.append(np.abs(model.background() - empty)[reflected].mean())
    assert np.mean(errors) < 3, errors
