"""Speed of the body tracker: frames a second."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2

from ....chains.body.articulated_pose import ArticulatedPose
from ....chains.body.dynamics import BodyDynamics
from ....chains.body.fixed_lag import BLOCK, FixedLag
from ....chains.body.flesh_tracker import FleshTracker
from ....inference import MultiChain, RecursiveBP, RunState
from ....models import BodyParts, Frame, HaarFaces, UpperBody
from ....models.numerics.threads import set_threads
from ...io.sources.open_source import open_source
from ..body_trackers import LAG, SignerFilm
from ..datasets import data_folder
from ..expectations import Expectation
from ..experiment import Findings
from .background import image_of
from .timing import over_frames, over_rounds

N_FRAMES = 78
WARM_UP = 24  # frames that do not count: hindsight begins with the 18th
TURN = BLOCK  # frames in a row on so many threads: hindsight answers for as many at a time
SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class BodyFilm:
    """Preloaded frames, who is to be tracked in them, and a word on where they come from."""

    label: str
    frames: Sequence[Frame]
    body: UpperBody
    parts: BodyParts

    @classmethod
    def found(cls) -> "BodyFilm":
        """A real signer with OpenCV's cascades where there are both, else a generated one with its list."""
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
    """What takes in a frame as `rsmcm body` does, without decoding and files: both chains, and hindsight."""
    flesh, pose = FleshTracker(film.body), ArticulatedPose(film.body, SAMPLES)
    engine = RecursiveBP(MultiChain().connect(flesh, film.parts).connect(pose, film.parts))
    hindsight, state = FixedLag(BodyDynamics(film.body), LAG), RunState()

    def step(frame: Frame) -> object:
        nonlocal state
        set_threads(threads)
        belief = engine.step(state, frame)
        state = belief.state
        return hindsight.add(frame, belief[pose], belief.evidence(film.parts).image)

    return step


def bodies() -> Findings:
    """Frames a second on one thread and on two, which take turns; OpenCV has one, as in all commands."""
    film = BodyFilm.found()
    height, width = image_of(film.frames[0]).shape[:2]
    what = f"body tracker, {film.label}, {width}x{height}, {SAMPLES} samples, lag {LAG}"
    cv2.setNumThreads(1)

    def judge(seconds: Mapping[str, float]) -> list[Expectation]:
        one, two = seconds["1"], seconds["2"]
        return [
            Expectation(f"{what}, one thread: frames a second", 1 / one),
            Expectation(f"{what}, two threads: frames a second", 1 / two, ">=", 30),
            Expectation(f"{what}: time on two threads over one", two / one, "<=", 0.75),
        ]

    steps = {str(threads): tracker(film, threads) for threads in (1, 2)}
    return Findings("Bodies", [], over_rounds(judge, over_frames(steps, film.frames, TURN, WARM_UP)))
