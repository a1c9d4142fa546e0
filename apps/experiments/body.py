"""Fig. 6 of the RSMCM paper: likelihood sampling with a tracker of flesh, without it, and CONDENSATION.

All of them as filters, and two with hindsight as well, on generated signers.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...chains.body.articulated_pose import ArticulatedPose
from ...chains.body.condensation import Condensation
from ...chains.body.dynamics import BodyDynamics
from ...chains.body.fixed_lag import FixedLag
from ...chains.body.flesh_tracker import FleshTracker
from ...chains.body.samples import BodySamples, body_moments
from ...inference import MultiChain, RecursiveBP
from ...inference.engine.recursive_bp import RunState
from ...models.body.parts import BodyParts
from ...models.body.upper_body import JOINTS, PARTS
from ...models.core.frame import Frame
from ...models.core.gaussian_message import squared_distances
from ..body.measures import (
    APART,
    ELBOWS,
    HANDS,
    LEAST_OFF,
    LEAST_VARIANCE,
    OFF,
    PLACES,
    RECOVERED,
    SOON,
    BodyTrial,
    coverage,
    exchanged_hands,
    pooled,
    recoveries,
)
from ..scenes import SignerScene, signer
from ..view.overlay import BodyOverlay, TrackedBody
from .experiment import Findings, Plot, by_seed, pictures
from .record import Expectation, Table, over_seeds

Image = NDArray[np.uint8]
Numbers = NDArray[np.float64]

HEAD_AND_HANDS = [JOINTS.index(name) for name in PARTS]
HAND_JOINTS = HEAD_AND_HANDS[1:]

LAG = 12  # frames by which answers with hindsight are late
N_SHOWN = 40  # poses that are drawn from a posterior to be shown, as in the paper

# --- trackers, which go through films in turns and are timed ------------------------------------------------


@dataclass(frozen=True, eq=False)
class SignerFilm:
    """Scene whose pictures are drawn once for all trackers, and its colours."""

    scene: SignerScene
    frames: Sequence[Frame]
    parts: BodyParts

    @classmethod
    def of(cls, **settings: Any) -> Self:
        """Return the scene of these settings of `signer`."""
        return cls.of_scene(signer(**settings))

    @classmethod
    def of_scene(cls, scene: SignerScene, rows: int | None = None) -> Self:
        """Return a scene whose pictures end after so many `rows`; skin is learned as from any clip."""
        frames = [replace(frame, image=frame.required_image()[:rows].copy()) for frame in scene]
        parts = BodyParts.learned([frame.required_image() for frame in frames], scene.detector)
        return cls(scene, frames, replace(parts, head_height=scene.body.head_height))


System = Literal["rsmcm", "sampler", "condensation", "flesh"]


@dataclass(frozen=True)
class BodyTracker:
    """Body tracker that is compared."""

    name: str  # for tables
    # `"rsmcm"`: likelihood sampling and the tracker of flesh correct each other. `"sampler"`: the same
    # without the message of the tracker of flesh. `"condensation"`: the bootstrap filter. `"flesh"`: the
    # tracker of flesh alone, which finds the hands only
    system: System
    samples: int  # number of poses; 0 where there are none
    # frames by which answers with hindsight are late, which are then given beside the filter's; 0 for none
    lag: int = 0

    def connected(self, film: SignerFilm) -> tuple[MultiChain, str]:
        """Return the model for a film, and the name of the chain that is measured."""
        body, parts, seed = film.scene.body, film.parts, film.scene.seed
        model = MultiChain()
        if self.system == "condensation":
            cloud = Condensation(body, self.samples, seed=seed)
            return model.connect(cloud, parts), cloud.name
        flesh = FleshTracker(body)
        model.connect(flesh, parts, feedback=self.system != "sampler")
        if self.system == "flesh":
            return model, flesh.name
        pose = ArticulatedPose(body, self.samples, seed=seed)
        return model.connect(pose, parts), pose.name


class _Run:
    """A tracker on its way through a film, and what was measured so far.

    After the first frame it is given the true pose, which CONDENSATION cannot find by itself. A tracker of
    flesh keeps what it has found.
    """

    def __init__(self, tracker: BodyTracker, film: SignerFilm, shown: Sequence[int]) -> None:
        model, self._chain = tracker.connected(film)
        self._engine, self._film, self._state = RecursiveBP(model), film, RunState()
        self._now, self._later = _EstimateLog(film.scene, shown), _EstimateLog(film.scene, shown)
        dynamics, seed = BodyDynamics(film.scene.body), film.scene.seed
        self._hindsight = FixedLag(dynamics, tracker.lag, seed=seed) if tracker.lag else None

    def step(self, index: int) -> None:
        """Run on frame `index`."""
        frame = self._film.frames[index]
        started = time.perf_counter()
        belief = self._engine.step(self._state, frame)
        seconds = time.perf_counter() - started
        self._state, found = belief.state, belief.state.states[self._chain]
        if index == 0 and isinstance(found, BodySamples):
            truth = self._film.scene.poses.take(np.zeros(len(found.poses), np.int64))
            found = BodySamples.even(truth, found.size, found.random)
            self._state = replace(belief.state, states={**belief.state.states, self._chain: found})
        self._now.add(found)
        self._now.seconds.append(seconds)
        if self._hindsight is None:
            return
        started = time.perf_counter()
        answers = self._hindsight.add(frame, found, belief.evidence(self._film.parts).image)
        if index == len(self._film.frames) - 1:
            answers += self._hindsight.flush()
        self._later.seconds.append(seconds + time.perf_counter() - started)
        for answer in answers:
            self._later.add(answer.samples)

    def trial(self) -> BodyTrial:
        """Return the measures."""
        trial = self._now.trial()
        return trial if self._hindsight is None else replace(trial, later=self._later.trial())


class _EstimateLog:
    """Log of a chain's estimates, frame by frame, beside the truth."""

    def __init__(self, scene: SignerScene, shown: Sequence[int]) -> None:
        self._scene, self._shown = scene, shown
        self._random = np.random.default_rng([scene.seed, 40])
        self._rows: list[tuple[Numbers, Numbers, Numbers, Numbers, float]] = []
        self._pictures: dict[int, TrackedBody] = {}
        self.seconds: list[float] = []

    def add(self, after: Any) -> None:
        """Add the state of a chain after the next frame."""
        index, effective = len(self._rows), np.nan
        if isinstance(after, BodySamples):
            joints, covariances = self._of_samples(index, after)
            effective = after.effective
        else:
            joints, covariances = np.full((8, 3), np.nan), np.full((8, 3, 3), np.nan)
            joints[HEAD_AND_HANDS, :2] = after.positions
            covariances[HEAD_AND_HANDS, :2, :2] = after.position_covariances
        apart = joints - self._scene.joints[index]
        of_hands = covariances[PLACES[HANDS], :2, :2] + LEAST_VARIANCE * np.eye(2)
        nees = squared_distances(apart[PLACES[HANDS], :2], of_hands)
        flat, deep = (np.linalg.norm(apart[PLACES, :axes], axis=1) for axes in (2, 3))
        self._rows.append((flat, deep, nees, joints[HAND_JOINTS, :2], effective))

    def _of_samples(self, index: int, after: BodySamples) -> tuple[Numbers, Numbers]:
        """Means and covariances of the joints; poses are drawn if they are shown."""
        body = self._scene.body
        found = body_moments(body, after)
        if index in self._shown:
            samples = body.joints(after.resample(N_SHOWN, self._random))
            self._pictures[index] = TrackedBody(samples, found.joints, found.joint_covariances)
        return found.joints, found.joint_covariances

    def trial(self) -> BodyTrial:
        """Return the measures."""
        flat, deep, nees, hands, effective = (np.array(row) for row in zip(*self._rows, strict=True))
        scene = self._scene
        truth = scene.joints[: len(hands), HAND_JOINTS, :2]
        return BodyTrial(
            errors=flat,
            errors_3d=deep,
            nees=nees,
            effective=effective,
            seconds=np.array(self.seconds),
            hidden=scene.hidden[: len(flat), 1:],
            exchanged=exchanged_hands(hands, truth, APART * scene.body.head_height),
            head_height=scene.body.head_height,
            shown=self._pictures,
        )


def in_turns(film: SignerFilm, trackers: Sequence[BodyTracker], shown: Sequence[int] = ()) -> list[BodyTrial]:
    """Run all trackers through a film; they take turns at every frame, so that times compare."""
    runs = [_Run(tracker, film, shown) for tracker in trackers]
    with _opencv_in_one_thread():
        for index in range(len(film.frames)):
            for run in runs:
                run.step(index)
    return [run.trial() for run in runs]


def on_one_scene(
    trackers: Sequence[BodyTracker], scene: Mapping[str, Any], shown: Sequence[int], n_frames: int, seed: int
) -> dict[str, BodyTrial]:
    """Draw a scene and run all trackers on it; smoothed estimates have a name of their own."""
    found = {}
    trials = in_turns(SignerFilm.of(**{**scene, "n_frames": n_frames, "seed": seed}), trackers, shown)
    for tracker, trial in zip(trackers, trials, strict=True):
        found[tracker.name] = trial
        if trial.later is not None:
            found[LATER.format(tracker.name)] = trial.later
    return found


@contextmanager
def _opencv_in_one_thread() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


# --- Fig. 6 -------------------------------------------------------------------------------------------------

SEEDS = range(20)
N_FRAMES = 120
SCENE: Mapping[str, Any] = {"n_frames": N_FRAMES, "detector_dropout": 0.2}
SHOWN = tuple(range(19, N_FRAMES, 20))
"""Indices of the frames of the figure: every twentieth, as in the paper."""

SAMPLES = 1000
MULTIPLES = (1, 3.2)  # of RSMCM's time a frame, hindsight included, that CONDENSATION is given
NEAR = 1.25  # ratio of errors below which a tracker comes near to another

TIMED_FRAMES, WARM_UP = 53, 5
"""Length of the scenes on which times are taken, and frames that do not count in any."""
TIMED_SEEDS = (100, 101)  # of these scenes
TIMED_SAMPLES: Mapping[System, tuple[int, int]] = {"sampler": (1000, 2000), "condensation": (2000, 10_000)}
"""Of those whose number of samples follows from the time that they are given: that of other numbers follows
from that of these."""
FEWEST_SAMPLES = 100

RSMCM = BodyTracker("RSMCM", "rsmcm", SAMPLES, LAG)
SAMPLER = "likelihood sampler, 1x the time"
FLESH = BodyTracker("flesh tracker alone", "flesh", 0)
CLOUDS = tuple(f"CONDENSATION, {multiple}x the time" for multiple in MULTIPLES)
LATER = f"{{}}, {LAG} frames later"  # a tracker with hindsight

ERRORS = (
    "tracker", "samples", "error, px", "head heights", "median, px", "hands, px", "elbows, px",
    "hands in 3-D, px", "elbows in 3-D, px",
)  # fmt: skip
BEHAVIOUR = (
    "tracker", "hands in 90 % region, %", "effective samples", "ms a frame", "over RSMCM's",
    "a hand off, % of frames", "mis-tracks", f"recovered in {SOON}, %", f"exchanged > {SOON} frames, scenes",
)  # fmt: skip
FAIR = (
    "Of the posterior mean, over all frames but the first. "
    "All trackers see the same pictures through the same features and the same likelihood, know the true "
    "lengths of the body, assume the same dynamics, and are given the true pose of the first frame, which "
    "CONDENSATION cannot find by itself. The first frame does not count."
)
NOTE = (
    "Time of a whole frame, features included, and hindsight where there is any: the median over stretches "
    f"of {LAG} frames, in one thread beside another scene, all trackers in turns. 1x the time is that of "
    "RSMCM with hindsight, and CONDENSATION's own hindsight comes on top of it. A mis-track: a hand's error "
    f"above {OFF:g} head heights in {LEAST_OFF} frames in a row. Recovered: below {RECOVERED:g} within "
    f"{SOON} frames from the first in which that hand looks like skin."
)

TrialsByTracker = dict[str, list[BodyTrial]]  # by tracker, one for each seed


def body() -> Findings:
    """Run Fig. 6."""
    trackers = compared()
    measure = partial(on_one_scene, trackers, SCENE, SHOWN)
    (found,) = by_seed("body", measure, [SCENE["n_frames"]], SEEDS).values()
    samples = {name: each.samples for each in trackers for name in (each.name, LATER.format(each.name))}
    errors = [[name, samples[name] or "", *errors_of(trials)] for name, trials in found.items()]
    behaviour = [[name, *behaviour_of(trials, found[RSMCM.name])] for name, trials in found.items()]
    scene = signer(**SCENE, seed=SEEDS[0])
    names = (RSMCM.name, LATER.format(RSMCM.name), SAMPLER, CLOUDS[0])
    return Findings(
        "Body",
        [Table(ERRORS, errors, FAIR), Table(BEHAVIOUR, behaviour, NOTE)],
        over_seeds(expectations_of, found),
        [draw_samples(scene, {name: found[name][0] for name in names})],
    )


def compared() -> list[BodyTracker]:
    """Return all trackers; those of `TIMED_SAMPLES` with as many samples as take their time."""
    timed = [RSMCM]
    timed += [BodyTracker(f"{system} {n}", system, n) for system, both in TIMED_SAMPLES.items() for n in both]
    measure = partial(on_one_scene, timed, SCENE, ())
    (found,) = by_seed("times", measure, [TIMED_FRAMES], TIMED_SEEDS).values()
    whole = seconds(found[LATER.format(RSMCM.name)])

    def given(name: str, system: System, multiple: float, lag: int = 0) -> BodyTracker:
        counts = TIMED_SAMPLES[system]
        few, many = (seconds(found[f"{system} {count}"]) for count in counts)
        return BodyTracker(name, system, samples_in(multiple * whole, counts, (few, many)), lag)

    clouds = [
        given(name, "condensation", multiple, LAG if multiple == 1 else 0)
        for name, multiple in zip(CLOUDS, MULTIPLES, strict=True)
    ]
    return [RSMCM, given(SAMPLER, "sampler", 1), *clouds, FLESH]


def samples_in(seconds: float, counts: tuple[int, int], timed: tuple[float, float]) -> int:
    """Return how many samples a tracker takes in so many seconds a frame, to two digits.

    It is known what it takes with two `counts` of samples; in between and beyond, time is linear.
    """
    few, many = timed
    slope = max(many - few, 1e-9) / (counts[1] - counts[0])
    count = max(counts[0] + (seconds - few) / slope, FEWEST_SAMPLES)
    return int(float(f"{count:.2g}"))


def errors_of(trials: Sequence[BodyTrial]) -> list[float | str]:
    """Return a tracker's cells of `ERRORS`, after its name and samples."""
    errors, deep = pooled(trials, "errors"), pooled(trials, "errors_3d")
    heads = np.mean([trial.error / trial.head_height for trial in trials])
    parts = [each[:, part].mean() for each in (errors, deep) for part in (HANDS, ELBOWS)]
    return _cells(errors.mean(), heads, np.median(errors), *parts)


def behaviour_of(trials: Sequence[BodyTrial], rsmcm: Sequence[BodyTrial]) -> list[float | str]:
    """Return a tracker's cells of `BEHAVIOUR`, after its name."""
    recovered, known = recoveries(trials)
    return _cells(
        100 * coverage(trials),
        np.median(pooled(trials, "effective")),
        1e3 * seconds(trials),
        seconds(trials) / seconds(rsmcm),
        100 * off(trials),
        sum(len(trial.mis_tracks) for trial in trials),
        100 * recovered / known if known else np.nan,
        exchanged(trials),
    )


def _cells(*values: float | np.floating[Any]) -> list[float | str]:
    return [float(value) if np.isfinite(value) else "–" for value in values]


def error(trials: Sequence[BodyTrial]) -> float:
    """Return the mean error over hands and elbows, frames and scenes, px."""
    return float(np.mean([trial.error for trial in trials]))


def off(trials: Sequence[BodyTrial]) -> float:
    """Return the share of frames in which a hand is lost."""
    return float(np.mean([trial.off for trial in trials]))


def exchanged(trials: Sequence[BodyTrial]) -> int:
    """Return the number of scenes in which the hands are exchanged for long."""
    return sum(trial.longest_exchange > SOON for trial in trials)


def seconds(trials: Sequence[BodyTrial]) -> float:
    """Return seconds a frame: median over stretches of frames, since smoothed estimates come several at a
    time.
    """
    stretches = [
        trial.seconds[first : first + LAG].mean()
        for trial in trials
        for first in range(WARM_UP, len(trial.seconds) - LAG + 1, LAG)
    ]
    return float(np.median(stretches))


def time_to_come_near(times: Sequence[float], ratios: Sequence[float]) -> float:
    """Return the time at which a ratio of errors falls to `NEAR`, interpolated; the last one if it never
    does.
    """
    for place, ratio in enumerate(ratios):
        if ratio <= NEAR:
            if not place:
                return times[0]
            share = (ratios[place - 1] - NEAR) / (ratios[place - 1] - ratio)
            return float(times[place - 1] ** (1 - share) * times[place] ** share)
    return times[-1]


def expectations_of(trials: TrialsByTracker) -> list[Expectation]:
    """Return what is expected of the trackers."""
    now, later, sampler = trials[RSMCM.name], trials[LATER.format(RSMCM.name)], trials[SAMPLER]
    clouds, cloud_later = [trials[name] for name in CLOUDS], trials[LATER.format(CLOUDS[0])]
    ratios = [error(cloud) / error(now) for cloud in clouds]
    times = [seconds(cloud) / seconds(now) for cloud in clouds]
    more = " (more than)" if min(ratios) > NEAR else ""
    recovered, known = recoveries(later)
    share = recovered / known if known else 1.0
    same = "error of RSMCM over the likelihood sampler's in the same time, both filtering"
    need = f"time in which CONDENSATION comes within {NEAR:g} of RSMCM's error, filtering, over RSMCM's{more}"
    who = f"RSMCM, {LAG} frames later"
    again = f"{who}: {known} mis-tracks, recovered within {SOON} frames, share"
    swapped = f"{who}: scenes with hands exchanged for more than {SOON} frames"
    return [
        Expectation(same, error(now) / error(sampler), "<=", 0.5),
        Expectation("over CONDENSATION's in the same time, both filtering", 1 / ratios[0], "<=", 0.7),
        Expectation(
            f"error of {who}, over CONDENSATION's filtering", error(later) / error(clouds[0]), "<=", 0.5
        ),
        Expectation(f"the same over CONDENSATION's {LAG} frames later", error(later) / error(cloud_later)),
        Expectation(need, time_to_come_near(times, ratios), ">=", 3.0),
        Expectation(again, share, ">=", 0.95),
        Expectation(f"{who}: hands within the 90 % region, share", coverage(later), ">=", 0.85),
        Expectation("the same, from above", coverage(later), "<=", 0.95),
        Expectation(f"{who}: a hand off by {OFF:g} head heights, share of frames", off(later), "<=", 0.06),
        Expectation(swapped, exchanged(later), "<=", 0),
    ]


def draw_samples(scene: SignerScene, trials: Mapping[str, BodyTrial]) -> Plot:
    """Draw poses of the posteriors, as in the paper: a row for each frame, a column for each tracker."""
    overlay, rows = BodyOverlay(scene.body.upper_arm + scene.body.forearm), []
    for index in SHOWN:
        frame = scene.frame(index)
        assert frame.image is not None
        drawn = [
            overlay.draw(frame.image, trial.shown[index], f"error {trial.errors[index].mean():.0f} px")
            for trial in trials.values()
        ]
        rows.append((f"frame {frame.number}", drawn))
    caption = f"Fig. 6: {N_SHOWN} poses of the posterior, over the picture and from the side."
    return pictures("fig-6.png", rows, list(trials), caption, 4.7)
