"""Saved runs: exact, checked, whole or not at all."""

import copy
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from rsmcm.apps import BodyTracker, FaceTracker, ObjectTracker, PointTracker
from rsmcm.apps.background.application import build_model
from rsmcm.chains import AdaptiveBackground, FleshTracker, LinearGaussianChain, MixtureBackground
from rsmcm.chains.objects.blob_records import RECORD
from rsmcm.inference import Incoming, MultiChain, Port, RecursiveBP, RunState
from rsmcm.inference.engine import checkpoint
from rsmcm.models import BodyParts, PixelLabels, PointTracks, UpperBody
from rsmcm.models.core.categorical import Categorical, CategoricalMessage
from rsmcm.models.core.frame import Frame

from ...support.discrete import image

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=5)
DTYPES = st.one_of(
    hnp.boolean_dtypes(), hnp.integer_dtypes(), hnp.floating_dtypes(), hnp.complex_number_dtypes()
)
ARRAYS = hnp.arrays(DTYPES, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3))
FLOATS = st.floats()


@dataclass(frozen=True, eq=False)
class Part:
    array: NDArray[Any]
    count: int
    score: float


class Named(NamedTuple):
    array: NDArray[Any]
    part: Part | None


@dataclass(frozen=True, eq=False)
class Tree:
    array: NDArray[Any]
    maybe: NDArray[Any] | None
    part: Part | None
    flag: bool
    text: str
    nothing: None
    pair: tuple[int, NDArray[Any]]
    named: Named
    parts: tuple[Part, ...]
    floats: list[float]
    by_number: dict[int, Part]
    by_name: dict[str, NDArray[Any]]
    random: np.random.Generator
    plain: Any


PARTS = st.builds(Part, ARRAYS, st.integers(), FLOATS)
GENERATORS = st.builds(
    lambda name, seed: np.random.Generator(getattr(np.random, name)(seed)),
    st.sampled_from(["PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64"]),
    st.integers(0, 2**64),
)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(TEXT, inner, max_size=2),
    max_leaves=4,
)
TREES = st.builds(
    Tree,
    array=ARRAYS,
    maybe=st.none() | ARRAYS,
    part=st.none() | PARTS,
    flag=st.booleans(),
    text=TEXT,
    nothing=st.none(),
    pair=st.tuples(st.integers(), ARRAYS),
    named=st.builds(Named, ARRAYS, st.none() | PARTS),
    parts=st.lists(PARTS, max_size=2).map(tuple),
    floats=st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=3),
    by_number=st.dictionaries(st.integers(), PARTS, max_size=2),
    by_name=st.dictionaries(TEXT, ARRAYS, max_size=2),
    random=GENERATORS,
    plain=PLAIN,
)


def assert_same(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    if isinstance(one, np.ndarray | np.generic):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        assert one.tobytes() == other.tobytes()
    elif isinstance(one, np.random.Generator):
        assert_same(one.bit_generator.state, other.bit_generator.state)
        assert one.random() == other.random()
    elif isinstance(one, Part | Tree):
        assert_same(vars(one), vars(other))
    elif isinstance(one, dict):
        assert list(one) == list(other)
        assert_same(list(one.values()), list(other.values()))
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for left, right in zip(one, other, strict=True):
            assert_same(left, right)
    else:
        assert one == other or (one != one and other != other)


@given(TREES)
def test_a_tree_comes_back_bit_for_bit(tmp_path_factory: pytest.TempPathFactory, tree: Tree) -> None:
    path = tmp_path_factory.getbasetemp() / "tree.npz"
    checkpoint.save(path, {"tree": tree}, {"tree": Tree})
    assert_same(checkpoint.load(path, {"tree": Tree})["tree"], tree)


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        ("a", int),
        (1.5, int),
        (True, int),
        (1, bool),
        (None, int),
        (1 << 60, float),
        (np.array("a")[()], float),
        ((1, 2), tuple[int]),
        ([1, "a"], list[int]),
        (np.arange(3), int | None),
        (3, NDArray[Any]),
        ({"a": np.arange(3)}, Any),
        (object(), Any),
        (np.array([None]), NDArray[Any]),
        (1, int | str),
        (1, complex),
        ({1: 2}, Part),
    ],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path: Path, value: Any, kind: Any) -> None:
    with pytest.raises((TypeError, ValueError)):
        checkpoint.save(tmp_path / "x.npz", {"x": value}, {"x": kind})
    assert not list(tmp_path.iterdir())


@dataclass(frozen=True, eq=False)
class WalkState:
    weights: NDArray[np.float64]
    steps: int
    random: np.random.Generator


class RandomWalk:
    """A chain that draws its predictions."""

    name = "walk"
    ports = (Port(Categorical),)

    def initial(self, frame: Frame) -> WalkState:
        return WalkState(np.full(3, 1 / 3), 0, np.random.default_rng(5))

    def predict(self, state: WalkState, dt: float) -> WalkState:
        random = copy.deepcopy(state.random)
        weights = state.weights + random.random(3)
        return WalkState(weights / weights.sum(), state.steps + 1, random)

    def message(self, state: WalkState, feature: Categorical, incoming: Incoming) -> CategoricalMessage:
        return CategoricalMessage(np.log(state.weights))

    def update(self, state: WalkState, incoming: Incoming) -> WalkState:
        weights = state.weights * incoming[Categorical].probabilities()
        return WalkState(weights / weights.sum(), state.steps, state.random)


def walking() -> RecursiveBP:
    door = Categorical("door", 3, lambda frame: np.log1p(np.arange(3) * float(frame.image.mean())))  # type: ignore[union-attr]
    return RecursiveBP(MultiChain().connect(RandomWalk(), door))


FRAMES = [image(3), None, image(7), image(1), image(2)]


@pytest.mark.parametrize("at", [1, 3])
def test_a_saved_run_goes_on_as_if_never_interrupted(tmp_path: Path, at: int) -> None:
    whole = list(walking().run(FRAMES))
    path = tmp_path / "run.npz"
    for belief in walking().run(FRAMES[:at]):
        walking().save(path, belief.state, {"source": "door.avi", "every": 1})
    state, about = walking().load(path)
    assert about == {"source": "door.avi", "every": 1}
    rest = list(walking().run(FRAMES[at:], state=state))
    for one, other in zip(whole[at:], rest, strict=True):
        assert one["walk"].weights.tobytes() == other["walk"].weights.tobytes()
        assert (one.state.time, one.state.number, one.state.shape) == (
            other.state.time,
            other.state.number,
            other.state.shape,
        )
        assert one.log_evidence == other.log_evidence
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def saved(path: Path) -> Path:
    *_, belief = walking().run(FRAMES)
    walking().save(path, belief.state)
    return path


def test_broken_bytes_are_never_read_as_something_else(tmp_path: Path) -> None:
    path = saved(tmp_path / "run.npz")
    content = path.read_bytes()
    expected = walking().load(path)[0]
    random = np.random.default_rng(0)
    for position in random.integers(len(content), size=60):
        broken = bytearray(content)
        broken[position] ^= 1 << random.integers(8)
        path.write_bytes(broken)
        message = f"{path}: "
        try:
            state, _ = walking().load(path)
        except ValueError as error:
            message = str(error)
        else:  # a date or a flag of the zip's own
            assert_same(vars(state.states["walk"])["weights"], vars(expected.states["walk"])["weights"])
            assert (state.number, state.time) == (expected.number, expected.time)
        assert message.startswith(f"{path}: ")
        assert "\n" not in message


def test_other_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    with pytest.raises(FileNotFoundError):
        walking().load(path)
    np.savez(path, a=np.arange(3))
    with pytest.raises(ValueError, match=r"run.npz: got .*expected a state that was saved here"):
        walking().load(path)
    np.savez(path, skeleton=np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"run.npz: got .*expected a state that was saved here"):
        walking().load(path)
    np.savez(path, skeleton=np.array(json.dumps({"format": "rsmcm state 0", "values": {}})))
    with pytest.raises(ValueError, match=r"run.npz: got format 'rsmcm state 0', expected 'rsmcm state 3'"):
        walking().load(path)


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of a saved state, without their digest."""
    with np.load(path) as file:
        return {name: array for name, array in file.items() if name != checkpoint.DIGEST}


def write_arrays(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write them with the digest of what they hold now."""
    np.savez(path, allow_pickle=False, **arrays, **{checkpoint.DIGEST: np.array(checkpoint._digest(arrays))})


def test_a_random_generator_without_its_state_is_refused(tmp_path: Path) -> None:
    path, kinds = tmp_path / "x.npz", {"x": np.random.Generator}
    checkpoint.save(path, {"x": np.random.default_rng(0)}, kinds)
    arrays = read_arrays(path)
    skeleton = json.loads(str(arrays["skeleton"]))
    skeleton["values"]["x"]["state"] = None
    arrays["skeleton"] = np.array(json.dumps(skeleton))
    write_arrays(path, arrays)
    with pytest.raises(ValueError, match=r"x: .*None"):
        checkpoint.load(path, kinds)


@pytest.fixture(scope="module")
def walker(tmp_path_factory: pytest.TempPathFactory) -> tuple[RecursiveBP, Path]:
    """An engine, and its saved state with an object."""
    scene = np.random.default_rng(0).integers(60, 90, (90, 120, 3), np.uint8)
    engine, frames = RecursiveBP(build_model()), []
    for number in range(1, 41):
        picture = scene.copy()
        if number > 20:
            picture[30:70, number : number + 20] = 220
        frames.append(Frame(picture, number / 25, number))
    *_, belief = engine.run(frames)
    assert len(belief["blobs"].blobs)
    path = tmp_path_factory.mktemp("walker") / "run.npz"
    engine.save(path, belief.state)
    return engine, path


def forged(path: Path, name: str, change: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
    """Change an array of a saved state, and give it the digest of what it holds now."""
    arrays = read_arrays(path)
    (place,) = (each for each in arrays if each.endswith(f"/{name}"))
    arrays[place] = change(arrays[place])
    write_arrays(path, arrays)


def with_number(number: float, field: str | None = None) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Put a number in the first place of an array, or of a field of the records of blobs."""

    def change(array: NDArray[Any]) -> NDArray[Any]:
        changed = array.copy()
        (changed.view(RECORD)[:, 0][field] if field else changed).reshape(-1)[0] = number
        return changed

    return change


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("background/light", lambda light: light[:-1], "background/covered: got shape"),
        ("background/light", with_number(-1.0), r"background: light: got \(\d+, \d+\) blocks.* above 0"),
        ("background/mean", lambda mean: mean[:, 1:], r"background/mean: got shape \(3, \d+\), expected"),
        ("background/noise", lambda noise: noise.astype(float), "background/noise: got an array of float64"),
        ("background/sway", with_number(np.nan), "background/sway: got NaN or infinity"),
        ("blobs/masks", lambda masks: masks[1:], "blobs/colours: got shape"),
        ("blobs/words", with_number(10**9, "start"), "blobs: got a record 0 of other pixels"),
        ("blobs/words", with_number(-1, "faint_top"), "blobs: got a record 0 of other pixels"),
        (
            "blobs/words",
            with_number(1e300, "position"),
            "blobs: got a record 0 of other pixels",
        ),
        ("ground/identities", lambda names: names[1:], "ground/feet: got shape"),
        ("ground/feet", with_number(1e15), "ground/feet: got .*, expected px that a picture may have"),
    ],
)
def test_a_forged_state_is_refused(
    walker: tuple[RecursiveBP, Path],
    tmp_path: Path,
    name: str,
    change: Callable[[NDArray[Any]], NDArray[Any]],
    message: str,
) -> None:
    """Loops index with what a state holds, so that a forged one would end the process."""
    engine, path = walker
    (tmp_path / "run.npz").write_bytes(path.read_bytes())
    forged(tmp_path / "run.npz", name, change)
    with pytest.raises(ValueError, match=rf"run\.npz: .*{message}"):
        engine.load(tmp_path / "run.npz")


PIXELS, PARTS, EYE = PixelLabels(), BodyParts(40.0), np.eye(2)


def of(chain: Any, feature: Any = PIXELS) -> RecursiveBP:
    return RecursiveBP(MultiChain().connect(chain, feature))


@pytest.mark.parametrize(
    ("saved", "other", "expected"),
    [
        (of(AdaptiveBackground()), of(AdaptiveBackground(noise=9.0)), "background.noise: got 30.0, expect"),
        (of(AdaptiveBackground()), of(MixtureBackground()), "background: got class, drift, .*, settle_"),
        (of(AdaptiveBackground()), of(AdaptiveBackground(), PixelLabels("p")), "model: got background, pi"),
        (
            of(FleshTracker(UpperBody.from_head(40)), PARTS),
            of(FleshTracker(UpperBody.from_head(50)), PARTS),
            "flesh.body.head_height: got 40.0, expected 50.0 as in the model$",
        ),
        (
            of(LinearGaussianChain(EYE, EYE, None, None, features=PointTracks), PointTracks()),
            of(LinearGaussianChain(EYE, 2 * EYE, None, None, features=PointTracks), PointTracks()),
            r"kalman.Q: got 'float64 \(2, 2\) \w+', expected 'float64 \(2, 2\) \w+'",
        ),
        (ObjectTracker(), PointTracker(), "got one of ObjectTracker, expected one of PointTracker"),
        (
            ObjectTracker(),
            ObjectTracker(parameters={"blobs": {"max_coast_time": 4.0}}),
            r"parameters.blobs.max_coast_time: got 0.6, expected 4.0",
        ),
        (PointTracker(points=50), PointTracker(), "points: got 50, expected 200"),
        (BodyTracker(samples=10), BodyTracker(samples=20), "samples: got 10, expected 20"),
        (FaceTracker(experts=3), FaceTracker(experts=4), "experts: got 3, expected 4"),
    ],
)  # fmt: skip
def test_a_state_of_another_model_is_refused_by_its_first_difference(
    tmp_path: Path, saved: Any, other: Any, expected: str
) -> None:
    path = tmp_path / "run.npz"
    saved.save(path, *([RunState()] if isinstance(saved, RecursiveBP) else []))
    with pytest.raises(ValueError, match=f"^{path}: .*{expected}"):
        other.load(path)
    saved.load(path)


def test_missing_fields_are_named(tmp_path: Path) -> None:
    path = tmp_path / "part.npz"
    checkpoint.save(path, {"part": {"count": 1}}, {"part": {"count": int}})
    with pytest.raises(ValueError, match=r"part.npz: part: got count, expected array, count, score"):
        checkpoint.load(path, {"part": Part})


def test_a_chain_without_a_declared_state_cannot_be_saved(tmp_path: Path) -> None:
    class Undeclared(RandomWalk):
        def initial(self, frame):  # type: ignore[no-untyped-def]
            return super().initial(frame)

    engine = RecursiveBP(MultiChain().connect(Undeclared(), Categorical("door", 3)))
    state = engine.step(RunState(), Frame(image(1), 0.0, 1)).state
    with pytest.raises(TypeError, match="'walk': initial has no return annotation"):
        engine.save(tmp_path / "run.npz", state)
