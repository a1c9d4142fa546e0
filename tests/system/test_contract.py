"""What all shipped chains keep to: any order of connections, and no memory but their states."""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import islice, permutations
from typing import Any

import numpy as np
import pytest
from rsmcm import chains as shipped
from rsmcm.apps.experiments.body import SignerFilm
from rsmcm.apps.scenes import face, shaken, sleeping_man
from rsmcm.chains import (
    AdaptiveBackground,
    ArticulatedPose,
    BlobTracker,
    CameraMotion,
    FleshTracker,
    GFlow,
    GroundPlane,
    PointTracker,
    RecursiveStructure,
)
from rsmcm.inference import Belief, CoordinateAscent, MultiChain, RecursiveBP
from rsmcm.models import Frame, ObjectBoxes, PixelLabels, PointTracks, ScenePixels
from rsmcm.models.core.frame import GivenPoints

from ..support.turning import turning

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


def links(name: str) -> tuple[list[Frame], list[tuple[object, object]]]:
    """Frames of a clip, and what is connected in the model that sees it."""
    if name == "scene":
        background, blobs, ground = AdaptiveBackground(), BlobTracker(confirmation_time=0.1), GroundPlane()
        return street(), [(background, PIXELS), (blobs, PIXELS), (blobs, BOXES), (ground, BOXES)]
    if name == "shaken scene":
        frames = list(shaken(sleeping_man(40, size=(160, 120), enter=5), margin=8))
        background, blobs = AdaptiveBackground(), BlobTracker(confirmation_time=0.1)
        return frames, [(CameraMotion(), SCENE), (background, SCENE), (blobs, SCENE)]
    if name == "points":
        return shape(), [(PointTracker(), POINTS), (RecursiveStructure(), POINTS)]
    body, parts = signer().scene.body, signer().parts
    return signer().frames, [(FleshTracker(body), parts), (ArticulatedPose(body, 50), parts)]


def run(frames: Sequence[Frame], connected: Sequence[tuple[object, object]]) -> Iterator[Belief]:
    model = MultiChain()
    for chain, feature in connected:
        model.connect(chain, feature)  # type: ignore[arg-type]
    return RecursiveBP(model).run(frames)


def assert_same(one: Any, other: Any) -> None:
    """All that two states hold is the same, byte for byte."""
    assert type(one) is type(other)
    if is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple | dict):
        values = (one.values(), other.values()) if isinstance(one, dict) else (one, other)
        for each, its in zip(*values, strict=True):
            assert_same(each, its)
    elif isinstance(one, np.random.Generator):
        assert_same(one.bit_generator.state, other.bit_generator.state)
    else:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["scene", "shaken scene", "points", "body"])
def test_any_order_of_connections_gives_the_same_bytes(name: str) -> None:
    frames, connected = links(name)
    usual = list(run(frames, connected))
    for order in islice(permutations(connected), 1, None, 5):
        for one, other in zip(usual, run(frames, order), strict=True):
            assert list(one.states) == list(other.states)
            assert_same(one.states, other.states)
            assert one.log_evidence == other.log_evidence
            if "scene" in name:
                np.testing.assert_array_equal(one["pixels"].foreground(), other["pixels"].foreground())


FILTERS = (
    "AdaptiveBackground", "ArticulatedPose", "BlobTracker", "CameraMotion", "Condensation",
    "DetectorRates", "FleshTracker",
    "GFlow", "GroundPlane", "MixtureBackground", "PointTracker", "RecursiveStructure",
)  # fmt: skip


def alone(name: str) -> tuple[list[Frame], list[tuple[object, object]]]:
    """Frames of a clip and the shipped chain of that name, with what it cannot do without."""
    kind = getattr(shipped, name)
    if name in ("PointTracker", "RecursiveStructure"):
        return shape()[:12], [(kind(), POINTS)]
    if name in ("FleshTracker", "ArticulatedPose", "Condensation"):
        film = signer()
        options = {} if name == "FleshTracker" else {"samples": 50}
        return film.frames, [(kind(film.scene.body, **options), film.parts)]
    if name == "GFlow":
        scene = face(3, 0, (192, 128))
        return list(scene), [(GFlow(scene.model, scene.poses[0], experts=2, texels=200), PIXELS)]
    if name in ("DetectorRates", "GroundPlane"):
        return street()[:12], [(kind(), BOXES)]
    if name == "CameraMotion":
        return street()[:12], [(kind(), SCENE), (AdaptiveBackground(), SCENE)]
    others = [(AdaptiveBackground(), PIXELS)] if name == "BlobTracker" else []
    return street()[:12], [(kind(), PIXELS), *others]


@pytest.mark.parametrize("name", FILTERS)
def test_a_used_chain_is_as_small_as_a_new_one(name: str) -> None:
    frames, connected = alone(name)
    chain = connected[0][0]
    before = len(pickle.dumps(chain))
    *_, last = run(frames, connected)
    assert np.isfinite(last.log_evidence)
    assert len(pickle.dumps(chain)) == before


def test_a_used_batch_chain_is_as_small_as_a_new_one() -> None:
    pair = PointTracker(), shipped.FactorStructure()
    before = [len(pickle.dumps(chain)) for chain in pair]
    model = MultiChain().connect(pair[0], POINTS).connect(pair[1], POINTS)
    CoordinateAscent(model, most_rounds=2).run(shape())
    assert [len(pickle.dumps(chain)) for chain in pair] == before
