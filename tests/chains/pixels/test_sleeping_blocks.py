"""Blocks that sleep: what wakes them, and that nothing else is different."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.pixels import sleeping_blocks
from rsmcm.chains.pixels.adaptive_background import AdaptiveBackground, BackgroundState
from rsmcm.chains.pixels.background_prediction import BackgroundPrediction, fast_path_thresholds
from rsmcm.chains.pixels.gaussians import LOWEST_NOISE, NOISE_STEPS, SURE, VARIANCE_STEPS
from rsmcm.inference import MultiChain, RecursiveBP, RunState
from rsmcm.models import Frame, PixelLabels
from rsmcm.models.pixels.background import SPAN

SIZE = (72, 192)
FRAME_TIME = 0.04
QUIET, NOISY = 2.5, float(np.sqrt(LOWEST_NOISE))  # deviations, grey levels


def scene(channels: int, seed: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    shape = SIZE if channels == 1 else (*SIZE, 3)
    return np.asarray(cv2.GaussianBlur(rng.integers(0, 256, shape).astype(np.uint8), (0, 0), 2))


def noisy(empty: NDArray[np.uint8], deviation: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    return np.rint(empty + rng.normal(0, deviation, empty.shape)).clip(0, 255).astype(np.uint8)


def known(chain: AdaptiveBackground, empty: NDArray[np.uint8]) -> BackgroundState:
    """A scene that is well known, after frames as many as of ten seconds."""
    state = chain.initial(Frame(image=empty, time=0.0, number=1))
    return replace(
        state,
        variance=np.full_like(state.variance, VARIANCE_STEPS),
        noise=np.full_like(state.noise, LOWEST_NOISE * NOISE_STEPS),
        age=10.0,
        frames=250,
        elapsed=FRAME_TIME,
    )


def predicted(state: BackgroundState, sleeping: bool = True) -> BackgroundPrediction:
    chain = AdaptiveBackground(follow_light=False, sleep=sleeping)
    prediction = chain._prediction(state, None)
    if not sleeping:
        return prediction
    return replace(prediction, in_turn=np.zeros_like(prediction.in_turn))


def awake(prediction: BackgroundPrediction, image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    thresholds = fast_path_thresholds(prediction.model, len(prediction.pixels.mean))
    light, flat = prediction.light.along_rows, image.reshape(-1)
    found = sleeping_blocks.find_awake(
        prediction.in_turn, prediction.frames, flat, prediction.pixels, light, thresholds
    )
    return found > 0


def of_pixels(blocks: NDArray[Any]) -> NDArray[Any]:
    """Blocks repeated over their pixels."""
    whole = blocks.repeat(sleeping_blocks.BLOCK_ROWS, axis=0).repeat(sleeping_blocks.BLOCK_COLUMNS, axis=1)
    return whole[: SIZE[0], : SIZE[1]]


def in_same_span(blocks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Blocks of spans that are compared as a whole where one of their blocks is awake."""
    pairs = blocks.reshape(len(blocks), -1, SPAN // sleeping_blocks.BLOCK_COLUMNS)
    return pairs.any(axis=2).repeat(pairs.shape[2], axis=1)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("seed", range(3))
def test_what_is_awake_is_compared_as_without_sleep(channels: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    empty = scene(channels, seed)
    state = known(AdaptiveBackground(), empty)
    image = noisy(empty, QUIET, rng)
    image[20:40, 90:110] = 255 - image[20:40, 90:110]
    plain, sleeping = predicted(state, sleeping=False), predicted(state)
    blocks = awake(sleeping, image)
    are_awake, asleep = (of_pixels(each).reshape(-1) for each in (blocks, ~in_same_span(blocks)))
    assert 0.05 < are_awake.mean() < 0.6
    expected, got = plain.compare(image).log_odds, sleeping.compare(image).log_odds
    np.testing.assert_array_equal(got[are_awake], expected[are_awake])
    assert 0.2 < asleep.mean() < 0.9
    assert (got[asleep] == SURE).all()
    for before, without, after in zip(state.pixels, plain.update(image), sleeping.update(image), strict=True):
        np.testing.assert_array_equal(after[..., are_awake], without[..., are_awake])
        if before is state.variance:  # grows by the drift, and is rounded to a step up or down
            drift = VARIANCE_STEPS * sleeping.drift
            grown = after[asleep].astype(float) - before[asleep] - drift
            assert (np.abs(grown) < 1).all()
            assert abs(grown.mean()) < 0.1
        else:
            np.testing.assert_array_equal(after[..., asleep], before[..., asleep])


@pytest.mark.parametrize("channels", [1, 3])
def test_each_block_wakes_for_one_strange_pixel_of_the_row_that_is_looked_at(channels: int) -> None:
    empty = scene(channels, 0)
    state = known(AdaptiveBackground(), empty)
    seen = set()
    for frames in range(sleeping_blocks.BLOCK_ROWS):
        prediction = predicted(replace(state, frames=frames))
        for row in range(sleeping_blocks.BLOCK_ROWS):
            image = empty.copy()
            image[24 + row, 70] = (image[24 + row, 70].astype(int) + 128) % 256
            found = awake(prediction, image)
            if found.any():
                assert found[2:5, 1:4].all()
                assert found.sum() == 9
                seen.add((frames, row))
    assert sorted(row for _, row in seen) == list(range(sleeping_blocks.BLOCK_ROWS))
    assert sorted(frames for frames, _ in seen) == list(range(sleeping_blocks.BLOCK_ROWS))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("deviation", [QUIET, NOISY])
def test_a_faint_small_object_wakes_within_two_frames(channels: int, deviation: float) -> None:
    rng, found, trials = np.random.default_rng(5), 0, 60
    for trial in range(trials):
        empty = scene(channels, trial) // 2 + 40
        state = known(AdaptiveBackground(), empty)
        first, height = int(rng.integers(1000)), (4, 5, 6, 8)[trial % 4]
        top, left = rng.integers(0, np.array(SIZE) - 12)
        there = np.zeros_like(empty)
        there[top : top + height, left : left + -(-40 // height)] = 12
        frames = [
            awake(
                predicted(replace(state, frames=first + k)),
                noisy(empty + there, deviation, rng),
            )
            for k in range(2)
        ]
        found += (of_pixels(frames[0] | frames[1])[there.reshape(*SIZE, -1).any(axis=-1)]).any()
    assert found >= 0.85 * trials  # 0.95, with the error of so few


@pytest.mark.parametrize("deviation", [QUIET, NOISY])
def test_noise_alone_wakes_few_blocks(deviation: float) -> None:
    rng, shares = np.random.default_rng(8), []
    for seed in range(30):
        empty = scene(3, seed) // 2 + 60
        prediction = predicted(replace(known(AdaptiveBackground(), empty), frames=seed))
        shares.append(awake(prediction, noisy(empty, deviation, rng)).mean())
    assert np.mean(shares) < 0.12  # with the eight around each


def test_each_block_has_its_turn_once_a_second() -> None:
    turns = np.array([sleeping_blocks.blocks_in_turn(SIZE, 0.04 * k, 0.04) for k in range(1000)])
    assert turns.shape[1:] == (9, 6)
    for block in turns.reshape(1000, -1).T:
        assert np.diff(np.flatnonzero(block)).max() <= 26
        assert 39 <= block.sum() <= 41
    assert turns.mean(axis=(1, 2)).max() <= 2 / 9  # no frame has many


def test_gaps_that_are_short_are_closed() -> None:
    blocks = np.array([[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0]], np.uint8)
    sleeping_blocks.close_gaps(blocks)
    np.testing.assert_array_equal(blocks, [[0, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0]])


@pytest.mark.parametrize("seed", range(3))
def test_masks_are_those_without_sleep(seed: int) -> None:
    rng, pixels = np.random.default_rng(seed), PixelLabels()
    empty = scene(3, seed)
    engines = [
        RecursiveBP(MultiChain().connect(AdaptiveBackground(sleep=each), pixels)) for each in (True, False)
    ]
    states = [RunState(), RunState()]
    differ, foreground = [], []
    for number in range(1, 176):
        image = noisy(empty, QUIET, rng)
        left = number % 130
        image[30:46, left : left + 12] = noisy(255 - empty[30:46, left : left + 12], QUIET, rng)
        masks = []
        for k, engine in enumerate(engines):
            belief = engine.step(states[k], Frame(image=image, time=FRAME_TIME * number, number=number))
            states[k] = belief.state
            masks.append(belief["pixels"].foreground() > 0)
        differ.append((masks[0] != masks[1]).mean())
        foreground.append(masks[1].mean())
    assert np.mean(foreground[100:]) > 0.005
    assert np.mean(differ) <= 2e-4
