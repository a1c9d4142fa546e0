"""Speed of tracking bodies by samples: frames a second and where the time goes; resampling beside filterpy, a
filter's step beside `particles`.

Set `OPENBLAS_NUM_THREADS=1` (or that of your BLAS) for the peers too. `particles` asks for numpy 1 and runs
with numpy 2 all the same: `pip install --no-deps particles joblib cloudpickle scikit-learn threadpoolctl
narwhals`. Without it, what is measured beside it is left out.
"""

import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from filterpy.monte_carlo import systematic_resample
from numpy.typing import NDArray

from ..chains.articulated_pose import ArticulatedPose
from ..chains.flesh_tracker import FleshTracker
from ..inference import MultiChain, RecursiveBP
from ..inference.body_dynamics import BodyDynamics
from ..inference.condensation import Condensation
from ..inference.protocols import Incoming
from ..inference.resampling import systematic
from ..models.body_image import edge_distances
from ..models.body_likelihood import BodyLikelihood
from ..models.body_parts import EDGE_REACH, HAND_RADIUS, BodyParts, PartMessage
from ..models.face_detectors import HaarFaces, PartDetector
from ..models.flesh_blobs import flesh_blobs
from ..models.frame import Frame
from ..models.gaussian_mixtures import GaussianMixtures
from ..models.threads import set_threads, thread_count
from ..models.upper_body import PARTS
from .bench_points import in_turns
from .body_trials import SignerFilm
from .claims import HEADER, Claim, in_columns

Numbers = NDArray[np.float64]

SAMPLES, DIMENSION = 1000, 13
STEP, NOISE = 0.1, 0.3  # standard deviations of a walk and of the looks at it
N_FRAMES = 400  # more than there are steps in the measurement

FILM_FRAMES = 40
WARM_UP = 5  # frames that do not count
SIZE = (640, 360)

Stages = list[tuple[str, float, float]]
"""Stage, ms a frame and share of the whole, %."""


def body_claims() -> tuple[list[Claim], Stages]:
    """All of them, and where the time goes: the tracker on two threads, peers and what they peer at on one."""
    film = SignerFilm.of(n_frames=FILM_FRAMES, size=SIZE)
    with _threads(2):
        stages = stages_of(film)
        claims = [rate_claim(film), growth_claim(film)]
    with _threads(1):
        return [*claims, *resampling_times(), *bootstrap_times()], stages


@contextmanager
def _threads(count: int) -> Iterator[None]:
    before = thread_count(), cv2.getNumThreads()
    set_threads(count)
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        set_threads(before[0])
        cv2.setNumThreads(before[1])


# --- the whole tracker --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _SearchedFaces:
    """The search for faces of OpenCV's cascades, where there are any, and the boxes of a scene's list.

    A drawn face is no face to a cascade, which then looks for profiles too: more work than with a real one.
    """

    listed: PartDetector
    searched: PartDetector

    def __call__(self, frame: Frame) -> Numbers:
        self.searched(frame)
        return self.listed(frame)


def _parts(film: SignerFilm) -> BodyParts:
    listed = film.scene.detector
    if not hasattr(cv2, "CascadeClassifier"):
        return film.parts
    face = 0.75 * film.parts.head_height
    return replace(film.parts, detector=_SearchedFaces(listed, HaarFaces(face)))


def seconds_a_frame(film: SignerFilm, samples: int) -> tuple[Numbers, dict[str, Numbers]]:
    """Of every frame after the first few, `(n,)`: the whole, and by stage those within chains and features."""
    body, spent = film.scene.body, _Spent()
    parts = _Timed(_parts(film), spent, {"evidence": "features"})
    dynamics = _Timed(BodyDynamics(body), spent, {"log_density": "temporal prior"})
    likelihood = _Timed(BodyLikelihood(body), spent, {"__call__": "likelihood"})
    pose = ArticulatedPose(body, samples, dynamics=dynamics, likelihood=likelihood)
    chain = _Timed(pose, spent, {name: "poses" for name in ("predict", "message", "update")})
    tracker = FleshTracker(body)
    flesh = _Timed(tracker, spent, {name: "flesh tracker" for name in ("predict", "message", "update")})
    engine = RecursiveBP(MultiChain().connect(flesh, parts).connect(chain, parts))
    state = None
    for frame in film.frames:
        with spent.frame():
            state = engine.step(state, frame).state
    return spent.whole[WARM_UP:], {name: values[WARM_UP:] for name, values in spent.stages().items()}


def rate_claim(film: SignerFilm) -> Claim:
    """With as many samples as usual, without rendering."""
    seconds, _ = seconds_a_frame(film, SAMPLES)
    width, height = SIZE
    what = f"body tracker {height}x{width}, {SAMPLES} samples, two threads: frames a second"
    return Claim(what, 1 / float(seconds.mean()), ">=", 10)


def growth_claim(film: SignerFilm) -> Claim:
    """Power of the time in samples, of the chain that has any."""
    counts = (SAMPLES, 5 * SAMPLES, 20 * SAMPLES)
    times = [float(np.median(seconds_a_frame(film, count)[1]["poses"])) for count in counts]
    power = float(np.polyfit(np.log(counts), np.log(times), 1)[0])
    what = f"body tracker: power of the poses' time in samples, {counts[0]} to {counts[-1]}"
    return Claim(what, power, "<=", 1.1)


def stages_of(film: SignerFilm) -> Stages:
    """Where the time of a frame goes: means of all frames after the first few."""
    whole, within = seconds_a_frame(film, SAMPLES)
    features = _features(film)
    mean = {name: float(values.mean()) for name, values in within.items()}
    total = float(whole.mean())
    parts = {
        **features,
        "features: the rest": mean["features"] - sum(features.values()),
        "flesh tracker": mean["flesh tracker"],
        "poses: drawing, and density of the draws": mean["poses"]
        - mean["temporal prior"]
        - mean["likelihood"],
        "poses: temporal prior": mean["temporal prior"],
        "poses: likelihood": mean["likelihood"],
        "engine and the rest": total - mean["features"] - mean["flesh tracker"] - mean["poses"],
        "total": total,
    }
    return [(name, 1e3 * value, 100 * value / total) for name, value in parts.items()]


def _features(film: SignerFilm) -> dict[str, float]:
    """Seconds a frame of what the feature node works out, each by itself."""
    parts = _parts(film)
    detector, flesh, unit = parts.detector, parts.flesh, parts.head_height
    assert detector is not None
    assert flesh is not None
    images = [frame.image for frame in film.frames if frame.image is not None]
    maps = [flesh.log_odds(image) for image in images]
    steps: dict[str, tuple[Callable[[Any], object], Sequence[object]]] = {
        "features: face detector": (detector, film.frames),
        "features: flesh map": (flesh.log_odds, images),
        "features: blobs": (lambda each: flesh_blobs(each, HAND_RADIUS * unit), maps),
        "features: edges": (lambda each: edge_distances(each, EDGE_REACH * unit), images),
    }
    return {name: _mean_seconds(step, of) for name, (step, of) in steps.items()}


def _mean_seconds(step: Callable[[Any], object], of: Sequence[object]) -> float:
    spent = []
    for each in of:
        started = time.perf_counter()
        step(each)
        spent.append(time.perf_counter() - started)
    return float(np.mean(spent[WARM_UP:]))


class _Spent:
    """Seconds of every frame, as a whole and by stage."""

    def __init__(self) -> None:
        self._whole: list[float] = []
        self._stages: list[dict[str, float]] = []

    @contextmanager
    def frame(self) -> Iterator[None]:
        self._stages.append({})
        started = time.perf_counter()
        yield
        self._whole.append(time.perf_counter() - started)

    def add(self, stage: str, seconds: float) -> None:
        now = self._stages[-1]
        now[stage] = now.get(stage, 0.0) + seconds

    @property
    def whole(self) -> Numbers:
        return np.array(self._whole)

    def stages(self) -> dict[str, Numbers]:
        names = {name: None for frame in self._stages for name in frame}
        return {name: np.array([frame.get(name, 0.0) for frame in self._stages]) for name in names}


class _Timed:
    """Something that notes how long some of its methods take, by the stage that each is part of."""

    def __init__(self, node: Any, spent: _Spent, stages: dict[str, str]) -> None:
        self._node = node
        self._spent = spent
        self._stages = stages
        self.name = getattr(node, "name", "")

    def __call__(self, *arguments: Any) -> Any:
        return self.__getattr__("__call__")(*arguments)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._node, name)
        if name not in self._stages:
            return value

        def timed(*arguments: Any) -> Any:
            started = time.perf_counter()
            try:
                return value(*arguments)
            finally:
                self._spent.add(self._stages[name], time.perf_counter() - started)

        return timed


# --- peers --------------------------------------------------------------------------------------------------


def resampling_times() -> list[Claim]:
    """Systematic resampling, ours from log weights, filterpy's from weights."""
    random = np.random.default_rng(0)
    claims = []
    for n in (SAMPLES, 20 * SAMPLES):
        weights = random.dirichlet(np.ones(n))
        log_weights = np.log(weights)

        def ours(log_weights: Numbers = log_weights, n: int = n) -> object:
            return systematic(log_weights, n, random)

        def theirs(weights: Numbers = weights) -> object:
            return systematic_resample(weights)

        seconds = in_turns({"ours": ours, "filterpy": theirs}, rounds=20)
        many = in_turns({"ours": ours}, rounds=20, turn=20)["ours"]
        claims += [
            Claim(f"systematic resampling of {n}, us", 1e6 * many),
            Claim(f"filterpy over systematic resampling of {n}", seconds["filterpy"] / many, ">=", 50),
        ]
    return claims


def bootstrap_times() -> list[Claim]:
    """A step of CONDENSATION over vectors with a Gaussian walk and likelihood, beside a bootstrap filter."""
    random = np.random.default_rng(0)
    looks = STEP * random.normal(size=(N_FRAMES, DIMENSION)).cumsum(axis=0)
    methods = {"ours": _condensation(looks)}
    if importlib.util.find_spec("particles") is not None:
        methods["particles"] = _bootstrap(looks)
    seconds = in_turns(methods, rounds=15, turn=20)
    what = f"CONDENSATION's step, {SAMPLES} x {DIMENSION}"
    claims = [Claim(f"{what}, ms", 1e3 * seconds["ours"])]
    if "particles" in seconds:
        claims.append(
            Claim(f"particles' bootstrap filter over {what}", seconds["particles"] / seconds["ours"], ">=", 2)
        )
    return claims


# --- the same walk for both ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Vectors:
    """Samples `(n, 13)` in the place of poses."""

    values: Numbers

    def __len__(self) -> int:
        return len(self.values)

    def take(self, chosen: Any) -> "_Vectors":
        return _Vectors(self.values.take(chosen, axis=0))


class _Anything:
    """A body without limits."""

    def allowed(self, vectors: _Vectors) -> NDArray[np.bool_]:
        return np.ones(len(vectors), np.bool_)


class _Walk:
    """A random walk, whose noise needs no more than single precision."""

    def draw(self, vectors: _Vectors, dt: float, random: np.random.Generator) -> _Vectors:
        steps = random.standard_normal(vectors.values.shape, np.float32)
        steps *= np.float32(STEP)
        return _Vectors(vectors.values + steps)


def _likelihood(look: Numbers, vectors: _Vectors) -> Numbers:
    off = vectors.values - look
    logs: Numbers = np.einsum("nd,nd->n", off, off)
    logs *= -0.5 / NOISE**2
    return logs


def _condensation(looks: Numbers) -> Callable[[], object]:
    """One step further at each call."""
    stand_ins: Any = (_Anything(), _Vectors(np.zeros((1, DIMENSION))), _Walk(), _likelihood)
    body, start, dynamics, likelihood = stand_ins
    chain = Condensation(body, SAMPLES, start, 0, dynamics, likelihood)
    state = chain.initial(Frame(np.zeros((2, 2), np.uint8), 0.0, 1))
    frames = iter(looks)
    nothing = GaussianMixtures.uniform(len(PARTS))

    def step() -> object:
        nonlocal state
        look: Any = next(frames)
        state = chain.update(chain.predict(state, 1.0), Incoming({"parts": PartMessage(nothing, look)}))
        return state

    return step


def _bootstrap(looks: Numbers) -> Callable[[], object]:
    """The same with `particles`, which resamples at every step too."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its age
        import particles
        from particles.distributions import MvNormal
        from particles.state_space_models import Bootstrap, StateSpaceModel

    unit = np.eye(DIMENSION)

    class Walk(StateSpaceModel):  # type: ignore[misc]
        def PX0(self) -> Any:  # noqa: N802
            return MvNormal(loc=np.zeros(DIMENSION), cov=unit)

        def PX(self, t: int, xp: Numbers) -> Any:  # noqa: N802
            return MvNormal(loc=xp, scale=STEP, cov=unit)

        def PY(self, t: int, xp: Numbers, x: Numbers) -> Any:  # noqa: N802
            return MvNormal(loc=x, scale=NOISE, cov=unit)

    model = Bootstrap(ssm=Walk(), data=list(looks))
    run = particles.SMC(fk=model, N=SAMPLES, resampling="systematic", ESSrmin=1.0)
    return lambda: next(run)


if __name__ == "__main__":
    found, where = body_claims()
    print(in_columns(HEADER, [claim.cells for claim in found]))
    print("\n" + in_columns(("stage", "ms", "share, %"), where))
