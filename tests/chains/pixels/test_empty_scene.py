"""The empty scene from a sample of frames: against a plain search, and known scenes."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.pixels.empty_scene import PRIOR_FRAMES, empty_scene
from rsmcm.chains.pixels.light import LightField
from rsmcm.models.pixels import colour

SIZE = (17, 23)
NOISE = 30.0
STEADY = LightField(np.ones((2, 2), np.float32), SIZE)


def seconds(images: Sequence[NDArray[np.uint8]], rate: float = 10.0) -> NDArray[np.float64]:
    return 5 + np.arange(len(images)) / rate


def lasting(
    colours: NDArray[np.float64], times: NDArray[np.float64], bandwidth: float
) -> tuple[NDArray[np.float64], float, int]:
    """Mean, mean square by channel and number of what is near the colour with most density times spread."""
    squares = ((colours[:, None] - colours[None]) ** 2).sum(axis=2)
    weights = np.maximum(bandwidth - squares, 0)
    middle = weights @ times / weights.sum(axis=1)
    best = (weights * np.abs(times - middle[:, None])).sum(axis=1).argmax()
    near = colours[squares[best] < bandwidth]
    return near.mean(axis=0), float(near.var(axis=0).mean()), len(near)


@pytest.mark.parametrize("shape", [SIZE, (*SIZE, 3)])
def test_every_pixel_gets_the_colour_that_is_seen_often_and_far_apart(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(0)
    places = random.integers(40, 200, (3, *shape))  # three colours a pixel
    images = [
        (places[random.integers(0, 3)] + random.normal(0, 4, shape)).clip(0, 255).astype(np.uint8)
        for _ in range(12)
    ]
    found = empty_scene(images, seconds(images), [STEADY], NOISE)
    planes = np.stack([colour.to_planes(image) for image in images]).astype(np.float64)
    for pixel in range(0, SIZE[0] * SIZE[1], 7):
        mean, scatter, support = lasting(planes[:, :, pixel], seconds(images), 8 * planes.shape[1] * NOISE)
        np.testing.assert_allclose(found.mean[:, pixel], mean, atol=1e-2)
        noise = (support * scatter + PRIOR_FRAMES * NOISE) / (support + PRIOR_FRAMES)
        assert found.noise[pixel] == pytest.approx(np.clip(noise, 20, 400), rel=1e-3)
        assert found.variance[pixel] == pytest.approx(max(found.noise[pixel] / support, 0.5), rel=1e-3)


def test_the_light_of_every_frame_is_taken_out() -> None:
    random = np.random.default_rng(2)
    scene = random.integers(60, 150, SIZE)
    lights = np.linspace(0.8, 1.4, 9)
    images = [(light * scene + random.normal(0, 1, SIZE)).round().astype(np.uint8) for light in lights]
    fields = [LightField(np.full((2, 2), light, np.float32), SIZE) for light in lights]
    known = empty_scene(images, seconds(images), fields, NOISE)
    np.testing.assert_allclose(known.mean[0], scene.reshape(-1), atol=1.5)
    np.testing.assert_array_equal(known.light, fields[0].blocks)
    unknown = empty_scene(images, seconds(images), [STEADY], NOISE)
    assert known.noise.mean() < 0.5 * unknown.noise.mean()


def stays(times: NDArray[np.float64], begins: float, ends: float) -> list[NDArray[np.uint8]]:
    """Somebody stands in the left half meanwhile."""
    random, images = np.random.default_rng(3), []
    for time in times - times[0]:
        image = 90 + random.normal(0, 2, SIZE)
        image[:, :11] += 70 * (begins <= time < ends)
        images.append(image.round().astype(np.uint8))
    return images


@pytest.mark.parametrize(
    ("begins", "ends", "somebody"),
    [
        (4.0, 20.0, False),  # in most of the film, but the scene was seen before
        (1.0, 6.5, False),  # before for a moment, and afterwards
        (0.0, 2.0, False),  # from the beginning, not for long
        (0.0, 7.0, True),  # from the beginning, still: nobody can know better
    ],
)
def test_who_stays_for_one_stretch_of_time_is_no_part_of_it(
    begins: float, ends: float, somebody: bool
) -> None:
    times = seconds(list(range(40)), 4.0)
    mean = empty_scene(stays(times, begins, ends), times, [STEADY], NOISE).mean.reshape(SIZE)
    assert np.abs(mean[:, :11] - (160 if somebody else 90)).max() < 4
    assert np.abs(mean[:, 11:] - 90).max() < 4


def test_what_is_covered_does_not_count_unless_it_always_is() -> None:
    times = seconds(list(range(20)), 4.0)
    images = stays(times, 0.0, 4.0)
    where = np.zeros(SIZE, bool)
    where[:, :11] = True
    for always, expected in ((False, 90), (True, 160)):
        covered = [where & (always or time - times[0] < 4.0) for time in times]
        mean = empty_scene(images, times, [STEADY], NOISE, covered).mean.reshape(SIZE)
        assert np.abs(mean[:, :11] - expected).max() < 4
