"""Speed of G-flow, beside optic flow, and of the body tracker on one thread and on two."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ....chains.body.articulated_pose import ArticulatedPose
from ....chains.body.dynamics import BodyDynamics
from ....chains.body.fixed_lag import BLOCK, FixedLag, Smoother
from ....chains.body.flesh_tracker import FleshTracker
from ....chains.face.gflow import GFlow, GFlowState
from ....inference import MultiChain, RecursiveBP, RunState
from ....inference.engine.protocols import Incoming
from ....models import BodyParts, Frame, HaarFaces, UpperBody
from ....models.numerics.threads import set_threads
from ....models.pixels.pixel_labels import PixelLabels, PixelMessage
from ...io.sources.open_source import open_source
from ...scenes import FaceScene, face
from ..body import LAG, SignerFilm
from ..datasets import data_folder
from ..experiment import Findings
from ..record import Expectation
from .background import image_of
from .timing import Spent, in_turns, over_frames, over_rounds

Numbers = NDArray[np.float64]

# --- faces --------------------------------------------------------------------------------------------------

RATE = 25.0  # frames a second, of the film
SIZE = (640, 480)
EXPERTS, TEXELS = 20, 4000
FACE_FRAMES = 25
FACE_WARM_UP = 5  # frames that do not count
ROUNDS, TURNS = 7, 10
WANTED = {EXPERTS: 6.0, 1: 13.0}  # times real time, by experts


def faces() -> Findings:
    """Measure all of G-flow; on two threads where the tracker runs, on one where a peer runs beside it."""
    scene = face(FACE_FRAMES, seed=0, size=SIZE)
    set_threads(2)
    rates = rate_expectations(scene)
    set_threads(1)
    return Findings("Faces", [], [*rates, *flow_expectations(scene)])


@lru_cache(maxsize=1)
def _frames(scene: FaceScene) -> Sequence[Frame]:
    """Rendered once."""
    return tuple(scene)


def seconds_a_frame(scene: FaceScene, experts: int, texels: int) -> Numbers:
    """Return seconds of every frame after the first few."""
    chain = GFlow(
        scene.model, scene.poses[0], experts=experts, texels=texels, covariance_scale=float(experts > 1)
    )
    state: GFlowState | None = None
    seconds = []
    for frame in _frames(scene):
        started = time.perf_counter()
        state = _followed(chain, state, frame)
        seconds.append(time.perf_counter() - started)
    return np.array(seconds[FACE_WARM_UP:])


def _followed(chain: GFlow, state: GFlowState | None, frame: Frame) -> GFlowState:
    state = chain.initial(frame) if state is None else chain.predict(state, 1 / RATE)
    return chain.update(state, Incoming({PixelLabels(): PixelMessage(image=frame.image)}))


def rate_expectations(scene: FaceScene) -> list[Expectation]:
    """Return how much faster than the film it is: over continuation and resampling frames, several runs."""
    spent: Spent = {experts: [] for experts in WANTED}
    for _ in range(ROUNDS):
        for experts in WANTED:
            spent[experts].append(float(seconds_a_frame(scene, experts, TEXELS).mean()))
    what = "G-flow 480x640, {} x {} texels, two threads: speed over {:g} frames/s"

    def judge(seconds: Mapping[Any, float]) -> list[Expectation]:
        return [
            Expectation(what.format(experts, TEXELS, RATE), 1 / (RATE * seconds[experts]), ">=", wanted)
            for experts, wanted in WANTED.items()
        ]

    return over_rounds(judge, spent)


def flow_expectations(scene: FaceScene) -> list[Expectation]:
    """Compare one dense expert with optic flow of as many points, forwards only and without a model."""
    after = _frames(scene)[FACE_WARM_UP + 1]
    here, there = scene.image(FACE_WARM_UP), scene.image(FACE_WARM_UP + 1)
    chain = GFlow(scene.model, scene.poses[0], experts=1, texels=TEXELS, covariance_scale=0.0)
    state: GFlowState | None = None
    for frame in _frames(scene)[: FACE_WARM_UP + 1]:
        state = _followed(chain, state, frame)
    surface = chain.object
    corners = surface.positions(scene.poses[FACE_WARM_UP])[0][surface.used_texels.groups]
    points = np.einsum("na,nac->nc", surface.texels.weights, corners[surface.texels.group_of_texel])
    nowhere: Any = None  # to begin from
    steps = {
        "expert": lambda: _followed(chain, state, after),
        "flow": lambda: cv2.calcOpticalFlowPyrLK(here, there, points[:, None], nowhere),
    }
    what = f"G-flow: PyrLK of {TEXELS} points over one expert of {TEXELS} texels, time"
    return over_rounds(
        lambda of: [Expectation(what, of["flow"] / of["expert"], ">=", 1.0)], in_turns(steps, ROUNDS, TURNS)
    )


# --- bodies -------------------------------------------------------------------------------------------------

N_FRAMES = 78
WARM_UP = 24  # frames that do not count: hindsight begins with the 18th
TURN = BLOCK  # frames in a row on so many threads: hindsight answers for as many at a time
SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class BodyFilm:
    """Preloaded frames, the person in them, and a word on their origin."""

    label: str
    frames: Sequence[Frame]
    body: UpperBody
    parts: BodyParts

    @classmethod
    def load(cls) -> Self:
        """Load a real signer with OpenCV's cascades where there are both, else a generated one."""
        try:
            path = data_folder("signer") / "signseg_demo_video.mp4"
            with open_source(str(path), stop=N_FRAMES) as source:
                frames = list(source)
            parts = BodyParts.learned([image_of(frame) for frame in frames], HaarFaces())
        except (OSError, ValueError):
            film = SignerFilm.of(n_frames=N_FRAMES)
            return cls("generated, no face detector", film.frames, film.scene.body, film.parts)
        return cls("a signer's film", frames, UpperBody.from_head(parts.head_height), parts)


def tracker(film: BodyFilm, threads: int) -> Callable[[Frame], object]:
    """Return a function that takes frames as `rsmcm body` does, without decoding and files."""
    flesh, pose = FleshTracker(film.body), ArticulatedPose(film.body, SAMPLES)
    engine = RecursiveBP(MultiChain().connect(flesh, film.parts).connect(pose, film.parts))
    smoothing = FixedLag(BodyDynamics(film.body), LAG)
    smoother = Smoother(engine, RunState(), smoothing, pose, film.parts, 0)

    def step(frame: Frame) -> object:
        set_threads(threads)
        return smoother.step(frame)

    return step


def bodies() -> Findings:
    """Measure frames a second on one thread and on two, in turns; OpenCV has one, as in all commands."""
    film = BodyFilm.load()
    height, width = image_of(film.frames[0]).shape[:2]
    what = f"body tracker, {film.label}, {width}x{height}, {SAMPLES} samples, lag {LAG}"
    cv2.setNumThreads(1)

    def judge(seconds: Mapping[Any, float]) -> list[Expectation]:
        one, two = seconds[1], seconds[2]
        return [
            Expectation(f"{what}, one thread: frames a second", 1 / one),
            Expectation(f"{what}, two threads: frames a second", 1 / two, ">=", 30),
            Expectation(f"{what}: time on two threads over one", two / one, "<=", 0.75),
        ]

    steps, early = {threads: tracker(film, threads) for threads in (1, 2)}, TURN // 2
    for step in steps.values():  # so that frames are smoothed in the middle of a turn, and done then
        for frame in film.frames[:early]:
            step(frame)
    spent = over_frames(steps, film.frames[early:], TURN, WARM_UP)
    return Findings("Bodies", [], over_rounds(judge, spent))
