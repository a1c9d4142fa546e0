"""Every chain: predicting for a, then for b seconds is predicting for a + b seconds."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm import chains
from rsmcm.apps.scenes import face, shaken, sleeping_man
from rsmcm.chains import (
    AdaptiveBackground,
    ArticulatedPose,
    BlobTracker,
    CameraMotion,
    DetectorRates,
    DiscreteChain,
    FleshTracker,
    GFlow,
    GroundPlane,
    LinearGaussianChain,
    MixtureBackground,
    PointTracker,
    RecursiveStructure,
)
from rsmcm.chains.body.condensation import Condensation
from rsmcm.chains.body.samples import BodySamples
from rsmcm.chains.objects.blobs import Blobs
from rsmcm.inference import MultiChain, RecursiveBP, kinematic
from rsmcm.models import Frame, ObjectBoxes, PixelLabels, PointTracks, ScenePixels
from rsmcm.models.body.upper_body import UpperBody
from rsmcm.models.core.frame import GivenBoxes, GivenPoints
from scipy.linalg import expm

from ..support.body_poses import resting

Prediction = tuple[Any, Any]
"""A chain and a state of it after a few frames."""

DT = 0.1
BODY = UpperBody.from_head(50)
BLANK = Frame(np.zeros((240, 320, 3), np.uint8), 0.0, 1)
STANDING = replace(resting([[160.0, 120.0]]), arms=np.tile([0.0, 0.8, -0.6], (1, 2, 2, 1)))


@cache
def walkers() -> dict[str, Prediction]:
    """Background, blobs and ground plane after 3 s in which two people have walked in."""
    random, images = np.random.default_rng(0), []
    scene = random.integers(90, 130, (120, 160, 3))
    for number in range(30):
        image = scene + random.normal(0, 3, scene.shape)
        for top, speed, value in ((20, 20, 20), (60, 35, 220)):
            left = round(speed * DT * number) - 16
            image[top : top + 40, max(left, 0) : max(left + 16, 0)] = value
        images.append(np.clip(image, 0, 255).astype(np.uint8))
    pixels, boxes = PixelLabels(), ObjectBoxes()
    all_chains = AdaptiveBackground(), BlobTracker(), GroundPlane()
    background, blobs, ground = all_chains
    model = MultiChain().connect(background, pixels).connect(blobs, pixels).connect(blobs, boxes)
    *_, last = RecursiveBP(model.connect(ground, boxes)).run(images, dt=DT)
    assert len(last["blobs"].blobs) == len(last["ground"].identities) == 2
    return {type(chain).__name__: (chain, last[chain.name]) for chain in all_chains}


def mixture() -> Prediction:
    chain = MixtureBackground()
    return chain, chain.initial(BLANK)


def shaken_camera() -> Prediction:
    chain = CameraMotion()
    engine = RecursiveBP(MultiChain().connect(chain, ScenePixels()))
    *_, last = engine.run(shaken(sleeping_man(6, size=(160, 120), noise=0.0), noise=3.0))
    return chain, last[chain.name]


def detector() -> Prediction:
    """Rates of a detector after four frames in which it finds two boxes."""
    boxes, chain = ObjectBoxes(), DetectorRates()
    found = GivenBoxes(
        np.array([[20.0, 30.0, 50.0, 110.0], [90.0, 40.0, 120.0, 130.0]]), np.array([0.4, 0.9])
    )
    frames = [Frame(BLANK.image, number * DT, number + 1, boxes=found) for number in range(4)]
    *_, last = RecursiveBP(MultiChain().connect(chain, boxes)).run(frames)
    return chain, last[chain.name]


def turning_points(chain: Any) -> Prediction:
    """A chain that follows points of a turning cloud, after 3 s."""
    random, points = np.random.default_rng(0), PointTracks()
    shape = random.normal(0, 100, (30, 3))
    frames = []
    for number in range(30):
        angle = 0.05 * number
        seen = np.stack([shape @ (np.cos(angle), 0, np.sin(angle)), shape[:, 1] + 0.3 * shape[:, 2]], axis=1)
        seen = 300 + seen + random.normal(0, 0.5, seen.shape)
        frames.append(Frame(None, number * DT, number + 1, GivenPoints(seen, np.arange(30))))
    *_, last = RecursiveBP(MultiChain().connect(chain, points)).run(frames)
    return chain, last[chain.name]


def flesh() -> Prediction:
    chain = FleshTracker(BODY)
    return chain, chain.predict(chain.initial(BLANK), 0.04)


def textured() -> Prediction:
    scene = face(5, seed=3)
    chain = GFlow(scene.model, scene.poses[0], experts=4, texels=400)
    engine = RecursiveBP(MultiChain().connect(chain, PixelLabels()))
    *_, last = engine.run([scene.image(number) for number in range(5)], dt=1 / 25)
    return chain, last[chain.name]


def kinematic_points() -> LinearGaussianChain:
    return LinearGaussianChain(
        lambda dt: kinematic(2, dt).along(2).transition,
        lambda dt: 400 * kinematic(2, dt).along(2).noise,
        np.eye(2, 4),
        np.eye(2),
        features=PointTracks,
        initial_covariance=1e4 * np.eye(4),
    )


def two_states() -> Prediction:
    chain = DiscreteChain(lambda dt: expm(dt * np.array([[-0.3, 0.3], [0.1, -0.1]])))
    return chain, chain.initial(BLANK)


CASES: dict[str, Callable[[], Prediction]] = {
    "AdaptiveBackground": lambda: walkers()["AdaptiveBackground"],
    "BlobTracker": lambda: walkers()["BlobTracker"],
    "DetectorRates": detector,
    "GroundPlane": lambda: walkers()["GroundPlane"],
    "MixtureBackground": mixture,
    "CameraMotion": shaken_camera,
    "PointTracker": lambda: turning_points(PointTracker()),
    "RecursiveStructure": lambda: turning_points(RecursiveStructure()),
    "FleshTracker": flesh,
    "GFlow": textured,
    "LinearGaussianChain": lambda: turning_points(kinematic_points()),
    "DiscreteChain": two_states,
}
SAMPLED: dict[str, Callable[[int], Any]] = {
    "ArticulatedPose": lambda seed: ArticulatedPose(BODY, 4000, start=STANDING, seed=seed),
    "Condensation": lambda seed: Condensation(BODY, 4000, start=STANDING, seed=seed),
}
BATCH_ONLY = {"FactorStructure", "FeatureMatcher", "NonrigidStructure", "ObjectTrajectories", "SceneFilter"}


def assert_close(one: Any, other: Any, place: str = "state") -> None:
    """The same to 1e-9 of the largest number in an array; generators of random numbers do not count."""
    assert type(one) is type(other), place
    if isinstance(one, Blobs):
        assert_close(list(one), list(other), place)  # rows, not the words in which they are kept
    elif is_dataclass(one):
        for field in fields(one):
            assert_close(getattr(one, field.name), getattr(other, field.name), f"{place}.{field.name}")
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), place
        for number, (part, its) in enumerate(zip(one, other, strict=True)):
            assert_close(part, its, f"{place}[{number}]")
    elif isinstance(one, np.ndarray | np.number | float) and np.asarray(one).dtype.kind == "f":
        numbers = np.asarray(one)
        largest = np.abs(numbers[np.isfinite(numbers)]).max(initial=0.0)
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9 * largest, err_msg=place)
    elif isinstance(one, np.ndarray | int | str | bool):
        np.testing.assert_array_equal(other, one, err_msg=place)


def test_all_chains_are_here() -> None:
    every = {name for name in chains.__all__ if hasattr(getattr(chains, name), "ports")}
    every -= {"ParticleChain"}  # whose dynamics are those that are given
    assert every - BATCH_ONLY <= {*CASES, *SAMPLED}


@pytest.mark.parametrize("name", CASES)
def test_two_or_ten_predictions_are_one_of_their_length(name: str) -> None:
    chain, state = CASES[name]()
    assert_close(chain.predict(chain.predict(state, 2.0), 0.04), chain.predict(state, 2.04), name)
    steps = state
    for _ in range(10):
        steps = chain.predict(steps, 0.04)
    assert_close(steps, chain.predict(state, 0.4), name)


def moments(state: BodySamples) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of all numbers of a pose."""
    poses = state.poses
    numbers = np.concatenate([poses.roots, poses.turns, poses.arms.reshape(len(poses), -1)], axis=1)
    return numbers.mean(axis=0), numbers.std(axis=0)


@pytest.mark.parametrize("name", SAMPLED)
def test_samples_are_spread_alike(name: str) -> None:
    """Means within five standard errors of 4000 samples, deviations within a tenth."""
    steps, at_once = (SAMPLED[name](seed) for seed in (0, 1))
    twice = steps.predict(steps.predict(steps.initial(BLANK), 0.1), 0.1)
    once = at_once.predict(at_once.initial(BLANK), 0.2)
    (mean, deviation), (expected, its_deviation) = moments(twice), moments(once)
    np.testing.assert_array_less(np.abs(mean - expected), 5 * np.sqrt(2 / 4000) * its_deviation)
    np.testing.assert_allclose(deviation, its_deviation, rtol=0.1)
