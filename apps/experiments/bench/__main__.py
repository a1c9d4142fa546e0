"""Speed beside peers, and exactness beside enumeration: `python -m rsmcm.apps.experiments.bench`.

Background and tracking beside OpenCV's MOG2 here; the others in `points`, `structure`, `face`,
`body_samples` and `body_tracker`.

All ratios are of times taken in one run, in turns, at equal thread counts.
"""

import itertools
import resource
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ....inference import Incoming, MultiChain, Port, RecursiveBP, RunState
from ....models import Categorical, Frame
from ....models.core.categorical import CategoricalMessage
from ....models.numerics.threads import set_threads
from ...background.application import build_model
from ...background.job import Engine
from ...background.methods import Model
from ...io.datasets import data_folder
from ...io.sources.open_source import open_source
from ...io.track_files import frames_of_tracks
from ...reports.expectations import Expectation
from ...reports.experiment import Experiment, run_and_publish
from ...reports.record import Table
from ...runs.progress import Progress
from ...scenes import cylinder, sleeping_man
from ...structure.reconstruction import engine_for
from .body_samples import bootstrap_times
from .body_tracker import body_expectations
from .face import face_expectations
from .points import point_expectations
from .structure import structure_expectations
from .timing import Spent, over_rounds

SIZE = (768, 576)
N_FRAMES = 240  # preloaded: 320 MB
TURN = 20  # frames that a method works on before it is another one's turn
WARM_UP = 40  # frames that do not count
ROUNDS = 2

STAGE = ("stage", "ms", "share, %")

PX = 100.0  # per radius of the cylinder
FEEDBACK_ROUNDS = 5

Image = NDArray[np.uint8]
Probabilities = NDArray[np.float64]


def main() -> None:
    """Measure everything; `--long` runs 10,000 frames for the memory instead of 1,500."""
    run_and_publish("bench", "make bench", Path("results") / "bench", bench)


def bench() -> Experiment:
    """Everything, beside what is wanted of it."""
    frames, label = _preloaded()
    expectations = [
        Expectation("BP against enumeration, greatest difference", enumeration_error(), "<=", 1e-12)
    ]
    for threads in (1, 2):
        set_threads(threads)
        expectations += speed_expectations(frames, threads)
    expectations += [end_to_end(frames), *over_time(frames, 10_000 if "--long" in sys.argv[1:] else 1_500)]
    set_threads(1)
    expectations += [
        *point_expectations(),
        *structure_expectations(),
        feedback_in_rounds(),
        *face_expectations(),
    ]
    of_bodies, stages_of_bodies = body_expectations()
    expectations += [*of_bodies, *bootstrap_times()]
    film = f"{len(frames)} frames of {label}, {SIZE[0]}x{SIZE[1]} colour, preloaded"
    tables = [
        Table(STAGE, stages(frames), f"Where the time of a frame goes, one thread; {film}."),
        Table(STAGE, stages_of_bodies, "Where the time of the body tracker goes, two threads."),
    ]
    return Experiment("Speed beside peers", tables, expectations)


def feedback_in_rounds() -> Expectation:
    """A round of coordinate ascent in which the tracker hears the shape, beside one in which it does not."""
    frames = frames_of_tracks(PX * cylinder(p_loose=0.1, p_drift=0.1, seed=0).tracks())
    spent: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(FEEDBACK_ROUNDS):
        before = time.perf_counter()
        for number, _ in enumerate(engine_for(frames, "second-order", "dual-chain").rounds(frames)):
            now = time.perf_counter()
            spent[number > 0].append(now - before)
            before = now
            if number == 1:
                break
    ratio = float(np.median(spent[True]) / np.median(spent[False]))
    return Expectation("structure: a round with feedback over one without, time", ratio - 1, "<=", 0.1)


def _preloaded() -> tuple[list[Frame], str]:
    """Frames of PETS2009 S2.L1 where they can be found, else of a generated scene."""
    try:
        with open_source(str(data_folder("pets2009-s2l1") / "vtest.avi"), stop=N_FRAMES) as source:
            return list(source), "PETS2009 S2.L1"
    except OSError:
        scene = sleeping_man(N_FRAMES, size=SIZE)
        with Progress("scene", N_FRAMES) as progress:
            frames = []
            for frame in scene:
                frames.append(frame)
                progress.update()
        return frames, "a generated scene"


# --- speed --------------------------------------------------------------------------------------------------


def over_frames(steps: Mapping[str, Callable[[Frame], object]], frames: Sequence[Frame]) -> Spent:
    """Median seconds a frame in each turn of several methods, which take turns of a few frames each.

    Parameters
    ----------
    steps
        by name, what takes in a frame.
    frames
        in order; all methods get all of them, several times over.
    """
    spent: Spent = {name: [] for name in steps}
    for _ in range(ROUNDS):
        for first in range(0, len(frames), TURN):
            for name, step in steps.items():
                seconds = []
                for frame in frames[first : first + TURN]:
                    started = time.perf_counter()
                    step(frame)
                    seconds.append(time.perf_counter() - started)
                spent[name].append(float(np.median(seconds)))
    return {name: values[WARM_UP // TURN :] for name, values in spent.items()}


def speed_expectations(frames: Sequence[Frame], threads: int) -> list[Expectation]:
    """Ratios of times a frame at a number of threads, which is set already."""
    subtractor = cv2.createBackgroundSubtractorMOG2()
    spent = over_frames(
        {
            "MOG2": lambda frame: subtractor.apply(_image(frame)),
            "pixels": _endless("stand-alone"),
            "feed-forward": _endless("feed-forward"),
            "dual": _endless("recursive-bp"),
        },
        frames,
    )
    return over_rounds(partial(_of_speeds, f"{threads} thread{'s' if threads > 1 else ''}"), spent)


def _of_speeds(at: str, seconds: Mapping[str, float]) -> list[Expectation]:
    return [
        Expectation(f"{at}: MOG2, ms a frame", 1e3 * seconds["MOG2"]),
        Expectation(f"{at}: pixel stage with mask, ms a frame", 1e3 * seconds["pixels"]),
        Expectation(f"{at}: feed-forward, ms a frame", 1e3 * seconds["feed-forward"]),
        Expectation(f"{at}: RSMCM with tracking, ms a frame", 1e3 * seconds["dual"]),
        Expectation(f"{at}: pixel stage over MOG2", seconds["pixels"] / seconds["MOG2"], "<=", 0.12),
        Expectation(f"{at}: RSMCM with tracking over MOG2", seconds["dual"] / seconds["MOG2"], "<=", 0.6),
        Expectation(
            f"{at}: RSMCM over feed-forward, % more", 100 * (seconds["dual"] / seconds["feed-forward"] - 1),
            "<=", 4,
        ),
    ]  # fmt: skip


def _endless(engine: Engine) -> Callable[[Frame], object]:
    """A model that takes frame after frame, whatever their own times are."""
    model, numbers = Model(engine, engine, SIZE), itertools.count(1)

    def step(frame: Frame) -> object:
        number = next(numbers)
        return model.step(Frame(frame.image, number / 10, number))

    return step


def end_to_end(frames: Sequence[Frame]) -> Expectation:
    """Frames a second on a video file, masks kept in memory; on the preloaded frames where there is none."""
    model = Model("RSMCM", "recursive-bp", SIZE)
    masks: list[Image] = []
    try:
        source: Iterator[Frame] = open_source(str(data_folder("pets2009-s2l1") / "vtest.avi"))
        label = "with decoding"
    except OSError:
        source, label = iter(frames), "without decoding (no video there)"
    started = time.perf_counter()
    masks.extend(model.step(frame).foreground.copy() for frame in source)
    rate = len(masks) / (time.perf_counter() - started)
    return Expectation(f"2 threads: frames a second, masks in memory, {label}", rate, ">=", 150)


def over_time(frames: Sequence[Frame], count: int) -> list[Expectation]:
    """Growth of time and memory over a clip that runs to and fro."""
    step = _endless("recursive-bp")
    order = [*frames, *reversed(frames[1:-1])]
    part = count // 5 if count < 5000 else 1000
    spent: list[float] = []
    early = 0.0
    with Progress(f"{count} frames", count) as progress:
        for frame in itertools.islice(itertools.cycle(order), count):
            started = time.perf_counter()
            step(frame)
            spent.append(time.perf_counter() - started)
            if len(spent) == part:
                early = _megabytes()
            progress.update()
    growth = float(np.median(spent[-part:]) / np.median(spent[:part]))
    return [
        Expectation(f"time a frame, last {part} over first {part} of {count}", growth, "<=", 1.1),
        Expectation(f"memory grown after frame {part} of {count}, MB", _megabytes() - early, "<=", 32),
        Expectation("memory with the preloaded frames, MB", _megabytes()),
    ]


def _megabytes() -> float:
    """Memory in use by this process; where the system does not tell, the most that it ever was."""
    pages = Path("/proc/self/statm")
    if pages.exists():
        return int(pages.read_text().split()[1]) * resource.getpagesize() / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


class _Timed:
    """A chain or feature that notes how long each of its methods takes."""

    def __init__(self, node: Any, spent: dict[str, float]) -> None:
        self._node = node
        self._spent = spent
        self.name = node.name

    @property  # type: ignore[misc]
    def __class__(self) -> Any:
        return self._node.__class__  # ports tell nodes by their class

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._node, name)
        if name not in ("predict", "message", "update", "evidence"):
            return value

        def timed(*arguments: Any) -> Any:
            started, before = time.perf_counter(), sum(self._spent.values())
            try:
                return value(*arguments)
            finally:
                key = f"{self.name}: {name}"
                # without what others were asked for meanwhile: messages are worked out when they are read
                own = time.perf_counter() - started - (sum(self._spent.values()) - before)
                self._spent[key] = self._spent.get(key, 0.0) + own

        return timed


def stages(frames: Sequence[Frame]) -> list[tuple[str, float, float]]:
    """Stage, ms a frame and share of the whole, of the dual chain."""
    spent: dict[str, float] = {}
    model = build_model()
    nodes = {name: _Timed(node, spent) for name, node in {**model.chains, **model.features}.items()}
    timed = MultiChain()
    for name in model.chains:
        for feature in model.features_of(name):
            timed.connect(nodes[name], nodes[feature], feedback=name in model.senders(feature))
    engine, state, whole = RecursiveBP(timed), RunState(), 0.0
    for index, frame in enumerate(frames):
        if index == WARM_UP:
            spent.clear()
            whole = 0.0
        started = time.perf_counter()
        belief = engine.step(state, frame)
        state = belief.state
        stepped = time.perf_counter()
        belief["pixels"].foreground()
        ended = time.perf_counter()
        spent["mask"] = spent.get("mask", 0.0) + ended - stepped
        whole += ended - started
    spent["engine and the rest"] = whole - sum(spent.values())
    count = max(len(frames) - WARM_UP, 1)
    return [(name, 1e3 * value / count, 100 * value / whole) for name, value in spent.items()]


# --- exactness ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Toy:
    """A hidden state with a few values and a table p(F | X) for each feature."""

    name: str
    prior: Probabilities
    transition: Probabilities
    tables: Mapping[str, Probabilities]

    ports = (Port(Categorical, many=True),)

    def initial(self, frame: Frame) -> Probabilities:
        return self.prior

    def predict(self, state: Probabilities, dt: float) -> Probabilities:
        moved: Probabilities = state @ self.transition
        return moved

    def message(self, state: Probabilities, feature: Categorical, incoming: Incoming) -> CategoricalMessage:
        return CategoricalMessage(
            np.log(self._heard(state, incoming, feature.name) @ self.tables[feature.name])
        )

    def update(self, state: Probabilities, incoming: Incoming) -> Probabilities:
        weights = self._heard(state, incoming)
        weights /= weights.sum()
        return weights

    def _heard(self, state: Probabilities, incoming: Incoming, without: str = "") -> Probabilities:
        for name, message in incoming.by_name(Categorical).items():
            if name != without:
                state = state * (self.tables[name] @ np.exp(message.log_weights))
        return state


def enumeration_error(n_frames: int = 10) -> float:
    """Greatest difference of chains' posteriors from the sum over all joint states, for three chains.

    The chains a, b, c meet on the features f (a, b) and g (b, c); all have three values.
    """
    random = np.random.default_rng(0)

    def table() -> Probabilities:
        values: Probabilities = random.random((3, 3)) + 0.05
        values /= values.sum(axis=1, keepdims=True)
        return values

    links = {"a": ("f",), "b": ("f", "g"), "c": ("g",)}
    chains = {
        name: _Toy(name, table()[0], table(), {feature: table() for feature in features})
        for name, features in links.items()
    }
    emissions = {name: table() for name in ("f", "g")}

    def likelihood(name: str, frame: Frame) -> Probabilities:
        assert frame.image is not None
        return emissions[name][:, frame.image[0, "fg".index(name)]]

    def node(name: str) -> Categorical:
        return Categorical(name, 3, lambda frame: np.log(likelihood(name, frame)))

    features = {name: node(name) for name in emissions}
    model = MultiChain()
    for name, connected in links.items():
        for feature in connected:
            model.connect(chains[name], features[feature])
    engine, state, error = RecursiveBP(model), RunState(), 0.0
    predictions = {name: chain.prior for name, chain in chains.items()}
    for number in range(1, n_frames + 1):
        frame = Frame(random.integers(0, 3, (1, 2)).astype(np.uint8), number / 25, number)
        if number > 1:
            predictions = {name: chain.predict(state.states[name], 1 / 25) for name, chain in chains.items()}
        joint = np.einsum(
            "a,b,c,af,bf,bg,cg,f,g->abcfg",
            *(predictions[name] for name in "abc"),
            *(chains[name].tables[feature] for name, feature in ("af", "bf", "bg", "cg")),
            likelihood("f", frame), likelihood("g", frame),
        )  # fmt: skip
        state = engine.step(state, frame).state
        for axis, name in enumerate("abc"):
            others = tuple(k for k in range(joint.ndim) if k != axis)
            exact = joint.sum(axis=others) / joint.sum()
            error = max(error, float(np.abs(exact - state.states[name]).max()))
    return error


def _image(frame: Frame) -> Image:
    assert frame.image is not None
    return frame.image


if __name__ == "__main__":
    main()
