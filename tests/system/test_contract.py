"""What all shipped chains keep to: any order of connections, no memory but states, time in seconds."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from itertools import islice, permutations
from typing import Any

import numpy as np
import pytest
from rsmcm import chains
from rsmcm.apps.experiments.body import SignerFilm
from rsmcm.apps.scenes import face, shaken, sleeping_man
from rsmcm.chains import (
    AdaptiveBackground,
    ArticulatedPose,
    BlobTracker,
    CameraMotion,
    Condensation,
    DetectorRates,
    FactorStructure,
    FleshTracker,
    GFlow,
    GroundPlane,
    MixtureBackground,
    PointTracker,
    RecursiveStructure,
)
from rsmcm.chains.objects.blobs import Blobs
from rsmcm.inference import Belief, CoordinateAscent, MultiChain, RecursiveBP
from rsmcm.models import Frame, GivenBoxes, ObjectBoxes, PixelLabels, PointTracks, ScenePixels, UpperBody
from rsmcm.models.core.frame import GivenPoints

from ..support.body_poses import resting
from ..support.turning import turning

Links = list[tuple[Any, Any]]

PIXELS, BOXES, POINTS = PixelLabels(), ObjectBoxes(), PointTracks(noise=0.3)
SCENE = ScenePixels(name="pixels")


@cache
def street() -> list[Frame]:
    return list(sleeping_man(60, size=(160, 120), enter=5))


@cache
def shape() -> list[Frame]:
    positions, _, _ = turning(40, degrees=80, noise=0.3)
    given = [GivenPoints(frame, np.arange(len(frame))) for frame in positions]
    return [Frame(None, 0.04 * time, time + 1, points) for time, points in enumerate(given)]


@cache
def signer() -> SignerFilm:
    return SignerFilm.of(n_frames=4, seed=2)


def scene() -> tuple[list[Frame], Links]:
    blobs = BlobTracker(confirmation_time=0.1)
    return street(), [(AdaptiveBackground(), PIXELS), (blobs, PIXELS), (blobs, BOXES), (GroundPlane(), BOXES)]


def shaken_scene() -> tuple[list[Frame], Links]:
    frames = list(shaken(sleeping_man(40, size=(160, 120), enter=5), margin=8))
    return frames, [(CameraMotion(), SCENE), (AdaptiveBackground(), SCENE), (BlobTracker(), SCENE)]


def points() -> tuple[list[Frame], Links]:
    return shape(), [(PointTracker(), POINTS), (RecursiveStructure(), POINTS)]


def body() -> tuple[list[Frame], Links]:
    person, parts = signer().scene.body, signer().parts
    return signer().frames, [(FleshTracker(person), parts), (ArticulatedPose(person, 50), parts)]


def condensation() -> tuple[list[Frame], Links]:
    return signer().frames, [(Condensation(signer().scene.body, samples=50), signer().parts)]


def detections() -> tuple[list[Frame], Links]:
    found = GivenBoxes(np.array([[20.0, 30, 50, 110], [90, 40, 120, 110]]), np.array([0.4, 0.9]))
    frames = [replace(frame, boxes=found) for frame in street()[:6]]
    return frames, [(DetectorRates(), BOXES), (MixtureBackground(), PIXELS)]


def talking_face() -> tuple[list[Frame], Links]:
    film = face(5, 3)
    return list(film), [(GFlow(film.model, film.poses[0], experts=4, texels=400), PIXELS)]


def run(frames: Sequence[Frame], links: Links) -> Iterator[Belief]:
    model = MultiChain()
    for chain, feature in links:
        model.connect(chain, feature)
    return RecursiveBP(model).run(frames)


def assert_same(one: Any, other: Any, tolerance: float, place: str = "state") -> None:
    """All that two states hold is the same, up to a share of the largest number of an array."""
    assert type(one) is type(other), place
    if isinstance(one, Blobs):
        one, other = list(one), list(other)  # rows, not the words in which they are kept
    if is_dataclass(one):
        for field in fields(one):
            parts = getattr(one, field.name), getattr(other, field.name)
            assert_same(*parts, tolerance, f"{place}.{field.name}")
    elif isinstance(one, tuple | list | dict):
        values = (one.values(), other.values()) if isinstance(one, dict) else (one, other)
        for part, its in zip(*values, strict=True):
            assert_same(part, its, tolerance, place)
    elif isinstance(one, np.random.Generator):
        if not tolerance:
            assert_same(one.bit_generator.state, other.bit_generator.state, tolerance)
    elif tolerance and isinstance(one, np.ndarray | float) and np.asarray(one).dtype.kind == "f":
        largest = np.abs(np.asarray(one)[np.isfinite(one)]).max(initial=0.0)
        np.testing.assert_allclose(other, one, rtol=tolerance, atol=tolerance * largest, err_msg=place)
    elif isinstance(one, np.ndarray | int | float | str):
        np.testing.assert_array_equal(other, one, err_msg=place)


@pytest.mark.parametrize("clip", [scene, shaken_scene, points, body])
def test_any_order_of_connections_gives_the_same_bytes(clip: Callable[[], tuple[list[Frame], Links]]) -> None:
    frames, links = clip()
    usual = list(run(frames, links))
    for order in islice(permutations(links), 1, None, 5):
        for one, other in zip(usual, run(frames, list(order)), strict=True):
            assert list(one.states) == list(other.states)
            assert_same(one.states, other.states, 0.0)
            assert one.log_evidence == other.log_evidence
            if PIXELS.name in one.states:
                np.testing.assert_array_equal(one[PIXELS].foreground(), other[PIXELS].foreground())


SAMPLED: dict[str, Callable[..., Any]] = {"ArticulatedPose": ArticulatedPose, "Condensation": Condensation}
CLIPS = (scene, shaken_scene, points, body, condensation, detections, talking_face)


@pytest.mark.parametrize("clip", CLIPS)
def test_chains_remember_nothing_and_predict_in_seconds(
    clip: Callable[[], tuple[list[Frame], Links]],
) -> None:
    frames, links = clip()
    used = {chain.name: chain for chain, _ in links}
    before = {name: len(pickle.dumps(chain)) for name, chain in used.items()}
    *_, last = run(frames, links)
    assert np.isfinite(last.log_evidence)
    assert {name: len(pickle.dumps(chain)) for name, chain in used.items()} == before
    for name, chain in used.items():
        if type(chain).__name__ not in SAMPLED:
            state = last[name]
            twice = chain.predict(chain.predict(state, 2.0), 0.04)
            assert_same(twice, chain.predict(state, 2.04), 1e-9, name)


def test_all_chains_are_tried() -> None:
    every = {name for name in chains.__all__ if hasattr(getattr(chains, name), "initial")}
    tried = {type(chain).__name__ for clip in CLIPS for chain, _ in clip()[1]}
    assert every - tried <= {"LinearGaussianChain", "DiscreteChain", "ParticleChain"}


@pytest.mark.parametrize("name", SAMPLED)
def test_samples_are_spread_alike_however_long_a_step_is(name: str) -> None:
    """Means within five standard errors of 4000 samples, deviations within a tenth."""
    start = replace(resting([[160.0, 120.0]]), arms=np.tile([0.0, 0.8, -0.6], (1, 2, 2, 1)))
    blank = Frame(np.zeros((240, 320, 3), np.uint8), 0.0, 1)
    steps, at_once = (SAMPLED[name](UpperBody.from_head(50), 4000, start=start, seed=seed) for seed in (0, 1))
    states = (
        steps.predict(steps.predict(steps.initial(blank), 0.1), 0.1),
        at_once.predict(at_once.initial(blank), 0.2),
    )
    one, other = (
        np.concatenate([each.poses.roots, each.poses.turns, each.poses.arms.reshape(4000, -1)], axis=1)
        for each in states
    )
    off = np.abs(one.mean(axis=0) - other.mean(axis=0))
    np.testing.assert_array_less(off, 5 * np.sqrt(2 / 4000) * other.std(axis=0))
    np.testing.assert_allclose(one.std(axis=0), other.std(axis=0), rtol=0.1)


def test_a_used_batch_chain_is_as_small_as_a_new_one() -> None:
    pair = PointTracker(), FactorStructure()
    before = [len(pickle.dumps(chain)) for chain in pair]
    model = MultiChain().connect(pair[0], POINTS).connect(pair[1], POINTS)
    CoordinateAscent(model, most_rounds=2).run(shape())
    assert [len(pickle.dumps(chain)) for chain in pair] == before
