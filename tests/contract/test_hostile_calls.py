"""Whatever a public function or constructor is given by mistake, one line names the parameter.

Each call that is right is tried once for each of its parameters and each value that cannot be meant. What a
wrong value is follows from the annotation, so that a new parameter is tried without a line here.
"""

import inspect
from collections.abc import Callable, Iterator
from functools import partial
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
import rsmcm.apps
import rsmcm.chains
import rsmcm.inference
import rsmcm.models
from rsmcm.chains import AdaptiveBackground, BodyDynamics, GFlow, PointTracker
from rsmcm.inference import CoordinateAscent, MultiChain, RecordedPredictions, RecursiveBP, RunState
from rsmcm.models import (
    Frame,
    GaussianMessage,
    MorphableModel,
    PixelLabels,
    PointTracks,
    Poses,
    UpperBody,
)
from rsmcm.models.core.checks import UNBOUNDED, Bound

PACKAGES = (rsmcm.models, rsmcm.inference, rsmcm.chains, rsmcm.apps)
IMAGE = np.zeros((48, 64), np.uint8)
FRAME = Frame(IMAGE, 0.0, 1)
SURFACE = MorphableModel(np.array([[[0.0, 1, 0], [0, 0, 1], [0, 0, 0]]]), np.array([[0, 1, 2]]))


class Alien:
    """A value that no parameter is meant to have."""

    def __repr__(self) -> str:
        return "Alien()"


def upright() -> Poses:
    return Poses.upright(np.full((1, 2), 20.0), np.full(1, 8.0), 1)


def of_pixels() -> MultiChain:
    return MultiChain().connect(AdaptiveBackground(), PixelLabels())


def of_points() -> MultiChain:
    return MultiChain().connect(PointTracker(), PointTracks())


ARGUMENTS: dict[str, Callable[[], dict[str, Any]]] = {
    "BodyPoses": lambda: {
        "roots": np.zeros((1, 2)),
        "torsos": np.zeros((1, 3)),
        "necks": np.zeros((1, 3)),
        "arms": np.zeros((1, 2, 4)),
    },
    "CategoricalMessage": lambda: {"log_weights": np.zeros(2)},
    "BodyDynamics": lambda: {"body": UpperBody.from_head(40.0)},
    "FixedLag": lambda: {"dynamics": BodyDynamics(UpperBody.from_head(40.0))},
    "DiscreteChain": lambda: {"transition": np.eye(2)},
    "LinearGaussianChain": lambda: {
        "F": np.eye(2),
        "Q": np.eye(2),
        "H": None,
        "R": None,
        "features": PointTracks,
    },
    "ParticleChain": lambda: {
        "transition": abs,
        "message_of": abs,
        "log_likelihood": abs,
        "draw_initial": abs,
        "features": PointTracks,
    },
    "GaussianFeature": lambda: {"name": "place", "dimension": 2},
    "GaussianMessage": lambda: {
        "identities": np.arange(1),
        "information": np.ones((1, 2, 2)),
        "vector": np.ones((1, 2)),
        "log_scale": 0.0,
    },
    "GaussianMixtures": lambda: {
        "log_weights": np.zeros((1, 2)),
        "means": np.zeros((1, 2, 2)),
        "covariances": np.tile(np.eye(2), (1, 2, 1, 1)),
        "flat": np.zeros((1, 2), bool),
        "labels": np.zeros((1, 2), np.int64),
    },
    "PointMessage": lambda: {
        "positions": GaussianMessage.from_moments(np.arange(1), np.zeros((1, 2)), np.eye(2)[None])
    },
    "Port": lambda: {"kind": PixelLabels},
    "RecordedPredictions": lambda: {
        "first": np.zeros((3, 2)),
        "second": np.zeros((3, 2)),
        "observed": np.zeros((3, 2)),
        "noise": np.eye(2),
    },
    "UpperBody": lambda: vars(UpperBody.from_head(40.0)),
    "compare_predictions": lambda: {
        "recorded": RecordedPredictions(*np.zeros((3, 3, 2)), np.eye(2)),
        "groups": np.arange(3),
    },
    "compare_scores": lambda: {"scores": np.ones((3, 3)), "groups": np.arange(3)},
    "cost": lambda: {
        "stated": np.eye(2),
        "error": np.eye(2),
        "process": np.eye(2),
        "observation": np.eye(2),
    },
    "kinematic": lambda: {"order": 2, "dt": 0.1},
    "product_of": lambda: {"first": np.eye(2), "second": np.eye(2)},
    "noise_of_tracks": lambda: {"frames": []},
    "ArticulatedPose": lambda: {"body": UpperBody.from_head(40.0)},
    "Categorical": lambda: {"name": "door", "size": 2},
    "Condensation": lambda: {"body": UpperBody.from_head(40.0)},
    "BodyParts": lambda: {"head_height": 40.0},
    "CoordinateAscent": lambda: {"model": of_points()},
    "FleshTracker": lambda: {"body": UpperBody.from_head(40.0)},
    "Frame": lambda: {"image": IMAGE, "time": 0.0, "number": 1},
    "GFlow": lambda: {"model": SURFACE, "start": upright()},
    "GivenBoxes": lambda: {"xyxy": np.array([[1.0, 2, 5, 9]])},
    "GivenKeypoints": lambda: {"positions": np.full((1, 10, 2), 3.0), "scores": np.ones((1, 10))},
    "Layer": lambda: {"top": 3, "left": 4, "mask": np.ones((5, 6), np.float32), "appearance": None},
    "MorphableModel": lambda: {"bases": SURFACE.bases, "triangles": SURFACE.triangles},
    "Poses": lambda: {each: getattr(upright(), each) for each in ("rotations", "translations", "morphs")},
    "RecursiveBP": lambda: {"model": of_pixels()},
    "SceneFilter": lambda: {"model": of_pixels()},
    "frames_of_tracks": lambda: {"tracks": np.zeros((4, 5, 2))},
    "reconstruct": lambda: {"film": np.zeros((4, 5, 2))},
}
"""What a call needs to be right, of those that need something."""

METHODS: dict[str, tuple[Callable[[], Callable[..., Any]], Callable[[], dict[str, Any]]]] = {
    "RecursiveBP.run": (lambda: RecursiveBP(of_pixels()).run, lambda: {"frames": [IMAGE]}),
    "RecursiveBP.step": (
        lambda: RecursiveBP(of_pixels()).step,
        lambda: {"state": RunState(), "frame": FRAME},
    ),
    "RecursiveBP.load": (lambda: RecursiveBP(of_pixels()).load, lambda: {"path": "state.npz"}),
    "RecursiveBP.save": (
        lambda: RecursiveBP(of_pixels()).save,
        lambda: {"path": "state.npz", "state": RunState()},
    ),
    "CoordinateAscent.run": (lambda: CoordinateAscent(of_points()).run, lambda: {"frames": [IMAGE]}),
    "MultiChain.connect": (
        lambda: MultiChain().connect,
        lambda: {"chain": AdaptiveBackground(), "feature": PixelLabels()},
    ),
    "UpperBody.from_head": (lambda: UpperBody.from_head, lambda: {"head_height": 40.0}),
    "GFlow.template": (lambda: GFlow.template, lambda: {"model": SURFACE, "start": upright()}),
    "GFlow.optic_flow": (lambda: GFlow.optic_flow, lambda: {"model": SURFACE, "start": upright()}),
}

FILES = {"HaarFaces", "YuNetFaces"}  # read a file first
MADE_BY_ENGINES = {
    "BatchIncoming", "Belief", "BodySamples", "Cavity", "Incoming", "Labelling", "LazyFrames", "PartMessage",
    "PredictionErrors", "Reconstruction", "RunState", "Smoothed", "Solution", "TrackerState",
}  # fmt: skip


def public() -> Iterator[tuple[str, Callable[..., Any]]]:
    for package in PACKAGES:
        for name in package.__all__:
            thing = getattr(package, name)
            is_protocol = getattr(thing, "_is_protocol", False)
            if callable(thing) and not is_protocol and name not in FILES | MADE_BY_ENGINES:
                yield name, thing


def wrong_values(hint: Any) -> list[Any]:
    """Values that the annotation rules out."""
    if hint in (Any, object, inspect.Parameter.empty) or type(hint).__name__ == "TypeVar":
        return []
    kinds = set(_kinds(hint))
    if any(
        getattr(each, "_is_protocol", False) and not getattr(each, "_is_runtime_protocol", False)
        for each in kinds
    ):
        return []  # what has its members is one
    values: list[Any] = [Alien()]
    if kinds & {int, float}:
        values += [np.nan, [1.0, 2.0]]
    if str not in kinds:
        values.append("seven")
    if np.ndarray in kinds:
        values += [np.full((0, 7, 0, 7), np.nan)]
    if type(None) not in kinds:
        values.append(None)
    return values + [next(n for n in (-1, 2, 0) if not bound.holds(n)) for bound in _bounds(hint)]


def _bounds(hint: Any) -> Iterator[Bound]:
    """Bounds of a number that the annotation declares."""
    if get_origin(hint) is Annotated:
        number, *marks = get_args(hint)
        yield from (
            mark
            for mark in marks
            if isinstance(mark, Bound) and mark is not UNBOUNDED and number in (int, float)
        )
    for each in get_args(hint):
        yield from _bounds(each)


def _kinds(hint: Any) -> Iterator[Any]:
    origin, arguments = get_origin(hint), get_args(hint)
    alias = getattr(origin or hint, "__value__", None)
    if alias is not None:
        yield from _kinds(alias[arguments] if arguments else alias) if len(arguments) < 2 else ()
        return
    if origin is Annotated:
        yield from _kinds(get_args(hint)[0])
    elif type(hint).__name__ == "UnionType" or str(origin) == "typing.Union":
        for each in get_args(hint):
            yield from _kinds(each)
    elif str(origin) == "typing.Literal":
        yield from map(type, get_args(hint))
    else:
        yield origin or hint


def attempts() -> Iterator[Any]:
    calls = {name: (partial(_same, thing), ARGUMENTS.get(name, dict)) for name, thing in public()} | METHODS
    for name, (function, arguments) in calls.items():
        called = function()
        hints = get_type_hints(called.__init__ if isinstance(called, type) else called, include_extras=True)
        for parameter in inspect.signature(called).parameters.values():
            if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                yield pytest.param(
                    called,
                    arguments,
                    parameter.name,
                    hints.get(parameter.name, Any),
                    id=f"{name}-{parameter.name}",
                )


def _same(thing: Any) -> Any:
    return thing


@pytest.mark.parametrize(("called", "arguments", "name", "hint"), list(attempts()))
def test_one_line_names_the_parameter(
    called: Callable[..., Any], arguments: Callable[[], dict[str, Any]], name: str, hint: Any
) -> None:
    for value in wrong_values(hint):
        with pytest.raises(
            (TypeError, ValueError), match=rf"^[a-z_, ]*\b{name}\b.*: got .*, expected [^\n]*$"
        ):
            _called(called, arguments() | {name: value})


def _called(function: Callable[..., Any], arguments: dict[str, Any]) -> None:
    result = function(**arguments)
    if inspect.isgenerator(result):
        next(result)
