"""Figs. 3 and 4 of the G-flow paper, its models of background and occlusion, and a real film."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...chains.face.experts import find_modes
from ...chains.face.gflow import GFlow, GFlowState
from ...chains.face.pose_terms import PosePrior
from ...chains.face.start import FaceStart, start_from_landmarks
from ...chains.face.texture_filter import Texture
from ...chains.face.texture_likelihood import UNKNOWN_VARIANCE, Level, TextureLikelihood, image_pyramid
from ...chains.pixels.adaptive_background import AdaptiveBackground
from ...inference import MultiChain, RecursiveBP, RunState
from ...inference.engine.protocols import Incoming
from ...inference.sfm.nonrigid.learning import learn_shape
from ...models.core.frame import Frame
from ...models.face.model_files import read_correspondences, read_model
from ...models.face.morphable_model import Poses
from ...models.pixels.pixel_labels import PixelLabels, PixelMessage
from ..io.sources.open_source import open_source
from ..scenes import FaceScene, face
from .datasets import data_folder
from .experiment import Findings, Plot, by_seed, in_words, noisy
from .record import Expectation, Table, over_seeds

Numbers = NDArray[np.float64]

SEEDS = range(10)
LOST_SHARE = 0.5  # error from which a face counts as not followed, in sizes of the face
LOST_SECONDS = 1.0  # for how long at a stretch, unless it is so in the last frame

# --- trackers, and how they do ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of a tracker on a sequence."""

    # `(n_frames,)` px: distance in the picture of the vertices that were found from the true ones, mean over
    # all vertices, hidden ones too
    errors: Numbers
    # `(n_frames,)` px: the same in space, after the mean offset in depth is taken off, which a weak
    # perspective does not show
    errors_3d: Numbers
    size: float  # px: of the face
    dt: float  # s from frame to frame
    time: float = np.nan  # ms a frame, mean; NaN where it was not measured

    @classmethod
    def of(cls, scene: FaceScene, vertices: Numbers) -> Self:
        """Evaluate the vertices `(n_frames, n_vertices, 3)` px of a tracker on a scene."""
        errors = vertex_errors(vertices, scene.model.positions(scene.poses))
        return cls(*errors, float(scene.poses.sizes[0]), scene.dt)

    # the pose of the first frame was given

    @property
    def error(self) -> float:
        """Mean over the frames after the first, px."""
        return float(self.errors[1:].mean())

    @property
    def error_3d(self) -> float:
        """Mean over the frames after the first, px."""
        return float(self.errors_3d[1:].mean())

    @property
    def lost(self) -> bool:
        """Whether the error is above half the face's size at the end, or was for more than a second."""
        off = np.concatenate([[False], self.errors > LOST_SHARE * self.size, [False]])
        starts, ends = np.flatnonzero(off[1:] & ~off[:-1]), np.flatnonzero(off[:-1] & ~off[1:])
        longest = (ends - starts).max(initial=0) * self.dt
        return bool(off[-2] or longest > LOST_SECONDS)


Measured = Mapping[str, Sequence[Evaluation]]  # by tracker, one for each seed


def vertex_errors(estimated: Numbers, truth: Numbers) -> tuple[Numbers, Numbers]:
    """Return mean distances of vertices `(n, n_vertices, 3)`, each `(n,)` px: in the picture, and in space
    without the mean offset in depth.
    """
    off = estimated - truth
    off[..., 2] -= off[..., 2].mean(axis=1, keepdims=True)
    return np.linalg.norm(off[..., :2], axis=2).mean(axis=1), np.linalg.norm(off, axis=2).mean(axis=1)


def values(evaluations: Sequence[Evaluation], measure: str = "error") -> list[float]:
    """Return a measure of `Evaluation` of every sequence."""
    return [getattr(evaluation, measure) for evaluation in evaluations]


def median(evaluations: Sequence[Evaluation], measure: str = "error") -> float:
    """Return the median of a measure over the sequences."""
    return float(np.median(values(evaluations, measure)))


def quartiles(evaluations: Sequence[Evaluation], measure: str = "error") -> str:
    """Return median and quartiles over the sequences, as text."""
    return in_words(values(evaluations, measure), "-")


def n_lost(evaluations: Sequence[Evaluation]) -> int:
    """Return the number of sequences on which the face was lost."""
    return sum(evaluation.lost for evaluation in evaluations)


@dataclass(frozen=True, eq=False)
class Clip:
    """Scene whose pictures are drawn once for all trackers."""

    scene: FaceScene
    frames: Sequence[Frame]

    @classmethod
    def of(cls, **settings: Any) -> Self:
        """Return the scene of these settings of `face`."""
        scene = face(**settings)
        return cls(scene, list(scene))


def states(chain: GFlow, frames: Sequence[Frame]) -> Iterator[GFlowState]:
    """Yield the state after every frame of a chain that is on its own; all frames have a picture."""
    state, pixels = chain.initial(frames[0]), PixelLabels()
    for number, frame in enumerate(frames):
        if number:
            state = chain.predict(state, frame.time - frames[number - 1].time)
        state = chain.update(state, Incoming({pixels: PixelMessage(image=frame.image)}))
        yield state


@dataclass(frozen=True)
class Tracker:
    """G-flow with settings, the same for all sequences."""

    name: str  # for tables
    settings: Mapping[str, Any] = field(default_factory=dict)  # of `GFlow`, beyond model and start
    oracle: bool = False  # whether it is the floor: see `floor`

    def run(self, clip: Clip) -> Evaluation:
        """Follow the face through the clip from the true first pose."""
        chain = GFlow(clip.scene.model, clip.scene.poses[0], **{"recover": False, **self.settings})
        if self.oracle:
            return floor(clip, replace(chain, experts=1))
        found = [chain.mean_pose(state) for state in states(chain, clip.frames)]
        return Evaluation.of(clip.scene, clip.scene.model.positions(Poses.concatenated(found)))


def floor(clip: Clip, chain: GFlow) -> Evaluation:
    """Run the oracle: texture learned at the true poses, Gauss-Newton started at the true pose of each frame.

    Its prior is what the filter's would be if all had gone well before: a walk from the true pose of the
    previous frame. What remains is noise of the picture, the model's error, and texture that changes.
    """
    scene, truth = clip.scene, _GroundTruthTexture(chain, clip)
    found = [scene.poses[0]]
    for index in range(1, len(scene)):
        true = scene.poses[index]
        likelihood = truth.likelihood(index, truth.learn(index - 1), true)
        prior = PosePrior.after(scene.poses[index - 1], chain.dynamics, truth.size, scene.dt)
        modes = find_modes(likelihood, prior, true, chain.effective_pixels, coarsest=chain.levels - 1)
        found.append(modes.poses)
    return Evaluation.of(scene, scene.model.positions(Poses.concatenated(found)))


@dataclass(eq=False)
class _GroundTruthTexture:
    """Texture of a chain's object learned at the true poses, frame after frame."""

    chain: GFlow
    clip: Clip
    texture: Texture = field(init=False)

    def __post_init__(self) -> None:
        self.texture = self.chain.initial(self.clip.frames[0]).texture.of(np.zeros(1, np.int64))

    @cached_property
    def size(self) -> float:
        """Size of the face at the start, px, as the chain takes it."""
        return float(self.clip.scene.poses.sizes[0])

    def levels(self, index: int) -> list[Level]:
        """Picture `index` as the chain prepares it."""
        image, chain = self.clip.frames[index].image, self.chain
        assert image is not None
        return image_pyramid(image, self.size, n_levels=chain.levels, local_mean=chain.local_mean)

    def likelihood(self, index: int, texture: Texture, poses: Poses) -> TextureLikelihood:
        """What picture `index` says, seen with `texture`; visibility is that of `poses`."""
        surface, noise = self.chain.object, self.chain.noise
        temperature = texture.predicted(noise, self.clip.scene.dt).temperature(noise)
        seen = surface.visible(poses)
        return TextureLikelihood(surface, self.levels(index), texture.mean, temperature, seen)

    def learn(self, index: int) -> Texture:
        """The texture after the pictures up to `index`, of which this is the next."""
        truth, surface = self.clip.scene.poses[index], self.chain.object
        observed, seen = surface.observe(self.levels(index), truth, surface.visible(truth))
        noise, elapsed = self.chain.noise, self.clip.scene.dt if index else 0.0
        predicted = self.texture.predicted(noise, elapsed)
        self.texture = predicted.updated(observed, seen, noise, elapsed)
        return self.texture


def on_one_scene(
    trackers: Sequence[Tracker], scenes: Mapping[str, Mapping[str, Any]], name: str, seed: int
) -> dict[str, Evaluation]:
    """Run all trackers on the scene of a name and a seed."""
    clip = Clip.of(**scenes[name], seed=seed)
    return {tracker.name: tracker.run(clip) for tracker in trackers}


ERRORS = ("error, px", "error in 3-D, px", f"lost of {len(SEEDS)}")
OVER_SEQUENCES = "Medians and quartiles over the sequences."


def errors_of(evaluations: Sequence[Evaluation]) -> list[object]:
    """Return the cells of `ERRORS`."""
    return [quartiles(evaluations), quartiles(evaluations, "error_3d"), n_lost(evaluations)]


# --- Fig. 3a: what several experts are worth to flow, and a slow texture to all -----------------------------

QUICK = "quick motion"
EXPERTS_SCENE: Mapping[str, Any] = {"n_frames": 200, "motion": "fast"}
"""The difficult sequence: quick motion, large expressions, and a lamp that moves about."""

COUNTS = (1, 5, 10, 20)
ALMOST_FLOW = 0.99
FLOW_LEVELS = 2
"""Levels on which patches are searched for. The paper tells of the picture only, on which one expert is
lost at once. On three it seldom takes a wrong peak and leaves little to others."""
SLOW = 0.02

FLOW = "patches, flow, {} experts"
MANY = FLOW.format(COUNTS[-1])
ONE = "patches, flow, 1 expert"
DENSE_FLOW = "dense, flow, 1 expert"
DENSE = f"dense, gain {SLOW:g}, 20 experts"
ORACLE = f"oracle: dense, gain {SLOW:g}"

AT_PEAK = {"experts": 1, "covariance_scale": 0.0}
"""One expert that stays at its peak: constrained optic flow, where the texture is the last picture."""
PATCHES = {"surface": "patches", "gain": ALMOST_FLOW}
SINGLE = {"surface": "patches", "gain": 1.0, **AT_PEAK}
EXPERTS: Sequence[tuple[Tracker, str]] = (
    (Tracker(ONE, {**SINGLE, "levels": FLOW_LEVELS}), "#c0504d"),
    *(
        (Tracker(FLOW.format(count), {**PATCHES, "levels": FLOW_LEVELS, "experts": count}), colour)
        for count, colour in zip(COUNTS[1:], ("#e0a050", "#7fb0d8", "#1f5fa8"), strict=True)
    ),
    (Tracker(DENSE_FLOW, {"gain": 1.0, **AT_PEAK}), "#b06fb0"),
    (Tracker(f"dense, gain {SLOW:g}, 1 expert", {"gain": SLOW, **AT_PEAK}), "#6cc08b"),
    (Tracker(DENSE, {"gain": SLOW}), "#2a8a4b"),
    (Tracker(ORACLE, {"gain": SLOW}, oracle=True), "#555555"),
)
"""All systems that are compared, and their colours."""


def experts() -> Findings:
    """Run Fig. 3a."""
    measure = partial(on_one_scene, [tracker for tracker, _ in EXPERTS], {QUICK: EXPERTS_SCENE})
    found = by_seed("experts", measure, [QUICK], SEEDS)[QUICK]
    lines = [[name, *errors_of(evaluations)] for name, evaluations in found.items()]
    caption = f"Fig. 3a: error of the mean pose's vertices, median of {len(SEEDS)} sequences."
    return Findings(
        "Experts",
        [Table(("system", *ERRORS), lines, OVER_SEQUENCES)],
        over_seeds(expected_of_experts, found),
        [Plot("fig-3a.png", partial(draw_experts, found), (9.0, 5.0), caption)],
    )


def expected_of_experts(measured: Measured) -> list[Expectation]:
    """Return what is expected of ratios of medians."""

    def over(name: str, other: str, measure: str = "error") -> float:
        return median(measured[name], measure) / median(measured[other], measure)

    lost = "flow by patches: lost runs of 20 experts; half of those of one are wanted"
    return [
        Expectation("flow by patches: error of 20 experts over that of one", over(MANY, ONE), "<=", 0.7),
        Expectation("the same in 3-D", over(MANY, ONE, "error_3d"), "<=", 0.55),
        Expectation(lost, n_lost(measured[MANY]), "<=", n_lost(measured[ONE]) // 2),
        Expectation("dense, slow: error over the oracle", over(DENSE, ORACLE), "<=", 1.6),
        Expectation("dense, slow: error over one expert's dense flow", over(DENSE, DENSE_FLOW), "<=", 0.5),
        Expectation("dense, slow: error over one expert's flow by patches", over(DENSE, ONE), "<=", 0.2),
        Expectation("dense, slow: lost runs", n_lost(measured[DENSE]), "<=", 0),
    ]


def draw_experts(measured: Measured, canvas: Figure) -> None:
    """Draw the error over time, median over the sequences."""
    axis = canvas.add_subplot()
    for (name, evaluations), (_, colour) in zip(measured.items(), EXPERTS, strict=True):
        times = evaluations[0].dt * np.arange(len(evaluations[0].errors))
        errors = np.median([evaluation.errors for evaluation in evaluations], axis=0)
        dashed = "--" if name == ORACLE else "-"
        axis.plot(times[1:], errors[1:], dashed, color=colour, linewidth=1.4, label=name)
    axis.set(yscale="log", xlabel="time, s", ylabel="mean error of vertices, px")
    axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


# --- Fig. 3b: from template to flow, and gains that each texel learns for itself ----------------------------

GAINS = (0.001, 0.01, 0.1, 0.5, 0.999)
LEARNED = "learned"
GAIN_TRACKERS = [Tracker(f"{gain:g}", {"gain": gain, "texels": 800}) for gain in GAINS]
GAIN_TRACKERS.append(Tracker(LEARNED, {"gain": LEARNED, "texels": 800}))
"""Twenty experts on a dense texture; the temperature is the same for all gains."""

STEADY = "constant texture"
CHANGING = "texture that changes"
LAMP = "lamp that moves"
GAIN_SCENES: Mapping[str, Mapping[str, Any]] = {
    STEADY: {"n_frames": 200, "motion": "fast", "light": 0.0},
    CHANGING: {"n_frames": 200, "motion": "fast", "light": 0.0, "change": 30.0},
    LAMP: {"n_frames": 200, "motion": "fast", "light": 1.0},
}
"""The first two are in even light: a lamp that moves changes what texels look like."""


def gain() -> Findings:
    """Run Fig. 3b."""
    everything = by_seed("gain", partial(on_one_scene, GAIN_TRACKERS, GAIN_SCENES), list(GAIN_SCENES), SEEDS)
    lines = [
        [scene, name, *errors_of(evaluations)]
        for scene, found in everything.items()
        for name, evaluations in found.items()
    ]
    caption = (
        f"Fig. 3b: error of the mean pose's vertices over the gain, median and quartiles of {len(SEEDS)} "
        "sequences; dashed, gains learned by each texel."
    )
    return Findings(
        "Gain",
        [Table(("scene", "gain", *ERRORS), lines, OVER_SEQUENCES)],
        over_seeds(expected_of_gains, everything),
        [Plot("fig-3b.png", partial(draw_gains, everything), (8.0, 4.5), caption)],
    )


def _best_gain(measured: Measured) -> float:
    return min(GAINS, key=lambda gain: median(measured[f"{gain:g}"]))


def expected_of_gains(everything: Mapping[str, Measured]) -> list[Expectation]:
    """Return what is expected of ratios of medians."""
    best_gain = {scene: _best_gain(found) for scene, found in everything.items()}
    best = {scene: median(found[f"{best_gain[scene]:g}"]) for scene, found in everything.items()}
    flow, moved = median(everything[STEADY][f"{GAINS[-1]:g}"]), best_gain[CHANGING] / best_gain[STEADY]
    what = f"{STEADY}: error of flow (gain {GAINS[-1]:g}) over that of the best gain"
    learned = "error with learned gains over that of the best fixed gain"
    return [
        Expectation(what, flow / best[STEADY], ">=", 2.0),
        Expectation(f"{STEADY}: best gain", best_gain[STEADY]),
        Expectation(f"{CHANGING}: best gain over that of constant texture", moved, ">=", 2.0),
        *(
            Expectation(f"{scene}: {learned}", median(found[LEARNED]) / best[scene], "<=", 1.1)
            for scene, found in everything.items()
        ),
    ]


def draw_gains(everything: Mapping[str, Measured], canvas: Figure) -> None:
    """Draw the error over the gain, on a scale of its log odds, so that both ends are seen."""
    axis = canvas.add_subplot()
    places = np.log(np.array(GAINS) / (1 - np.array(GAINS)))
    for (scene, found), colour in zip(everything.items(), ("#1f5fa8", "#c98a2b", "#6cc08b"), strict=True):
        low, middle, high = np.percentile(
            [values(found[f"{gain:g}"]) for gain in GAINS], [25, 50, 75], axis=1
        )
        axis.plot(places, middle, "o-", color=colour, linewidth=1.4, label=scene)
        axis.fill_between(places, low, high, color=colour, alpha=0.2, linewidth=0)
        axis.axhline(median(found[LEARNED]), color=colour, linewidth=1.2, linestyle="--")
    axis.set_xticks(places, [f"{gain:g}" for gain in GAINS])
    axis.set(
        yscale="log", xlabel="gain in the steady state: template to flow", ylabel="mean error of vertices, px"
    )
    axis.legend(fontsize=9)


# --- Fig. 4: experts scattered about the pose find it, if they know what they look for ----------------------

RECOVERY_SEEDS = range(20)
RECOVERY_SCENE: Mapping[str, Any] = {"n_frames": 82}
N_EXPERTS = 20
SCATTER = 9.5  # px: mean distance of the experts' vertices from the true ones in the first frame
SOON = 9  # index of the frame by which the pose is wanted to be found, the tenth
SHOWN = (0, SOON, 80)
NEAR = 1.5  # px: error up to which the pose counts as found
KNOWN = "known texture"
BLANK = "blank texture"


@dataclass(frozen=True, eq=False)
class Recovery:
    """Errors of scattered experts on a sequence."""

    errors: Numbers  # `(n_frames,)` px: mean distance of the mean pose's vertices from the true ones
    at_first: Numbers  # `(n_experts,)` px: the same for every expert, in the first frame
    vertices: Numbers  # `(n_shown, n_experts, n_vertices, 2)` px, in the frames `SHOWN`


def recovery() -> Findings:
    """Run Fig. 4: texture known at the start, or learned by each expert at its own wrong pose."""
    (found,) = by_seed("recovery", recover, [N_EXPERTS], RECOVERY_SEEDS).values()
    lines: list[list[object]] = []
    for start, runs in found.items():
        errors = [[float(run.errors[index]) for run in runs] for index in SHOWN]
        lines.append(
            [start, *(f"{np.median(each):.3g} ({min(each):.3g}-{max(each):.3g})" for each in errors)]
        )
    header = ("texture at the start", *(f"error in frame {index + 1}, px" for index in SHOWN))
    scene = face(seed=RECOVERY_SEEDS[0], **RECOVERY_SCENE)
    pictures = [scene.image(index) for index in SHOWN]
    firsts = {start: runs[0] for start, runs in found.items()}
    vertices = f"Fig. 4: vertices of all {N_EXPERTS} experts on the first sequence."
    return Findings(
        "Recovery",
        [Table(header, lines, "Medians over the sequences (least - most).")],
        over_seeds(expected_of_recovery, found),
        [
            Plot("fig-4.png", partial(draw_scattered, pictures, firsts), (12.0, 6.5), vertices),
        ],
    )


def recover(n_experts: int, seed: int) -> dict[str, Recovery]:
    """Start experts about the true pose of a sequence, with both textures."""
    clip = Clip.of(seed=seed, **RECOVERY_SCENE)
    start = scattered(clip.scene, np.random.default_rng([seed, 9]))
    blank = GFlow(clip.scene.model, start, experts=n_experts, gain=0.03, recover=False, seed=seed)
    # what the object looks like in the first picture at the true pose, and surely so
    texture = _GroundTruthTexture(replace(blank, start=clip.scene.poses[0], texture=None), clip).learn(0)
    steady = np.full_like(texture.variance, blank.noise.steady_variance)
    seen = texture.variance < 0.5 * UNKNOWN_VARIANCE
    texture = replace(texture, variance=np.where(seen, steady, texture.variance))
    return {KNOWN: _recovered(clip, replace(blank, texture=texture)), BLANK: _recovered(clip, blank)}


def scattered(scene: FaceScene, random: np.random.Generator) -> Poses:
    """Return experts about the true pose of the first frame, `SCATTER` px from it in the mean over all
    vertices.

    Turned, shifted, sized and deformed at random, in proportions in which each of these moves vertices by
    about as much.
    """
    truth = scene.poses[np.zeros(N_EXPERTS, np.int64)]
    size = truth.sizes[0]
    deviations = np.full(truth.dimension, 0.5 * size)
    deviations[:6] = 0.2, 0.2, 0.2, 0.15 * size, 0.15 * size, 0.1 * size
    changes = deviations * random.standard_normal((N_EXPERTS, truth.dimension))
    factor = 1.0
    for _ in range(20):  # vertices do not move in proportion to a turn, but nearly
        poses = truth.moved(factor * changes)
        factor *= SCATTER / float(_distances(scene, poses, 0).mean())
    return poses


def _distances(scene: FaceScene, poses: Poses, index: int) -> Numbers:
    """`(n_poses,)` px: mean distance of vertices from the true ones."""
    distances: Numbers = np.linalg.norm(scene.model.project(poses) - scene.vertices[index], axis=2).mean(
        axis=1
    )
    return distances


def _recovered(clip: Clip, chain: GFlow) -> Recovery:
    scene, found = clip.scene, list(states(chain, clip.frames))
    means = [_distances(scene, chain.mean_pose(state), index)[0] for index, state in enumerate(found)]
    shown = [scene.model.project(found[index].poses) for index in SHOWN if index < len(found)]
    return Recovery(np.array(means), _distances(scene, found[0].poses, 0), np.array(shown))


def expected_of_recovery(runs_of: Mapping[str, Sequence[Recovery]]) -> list[Expectation]:
    """Return what is expected of the worst run; nothing is of a blank texture."""
    known, blank = runs_of[KNOWN], runs_of[BLANK]
    at_start = float(np.mean([run.at_first for run in known]))
    by_then, end = ([float(run.errors[index]) for run in blank] for index in (SOON, -1))
    largest = max(float(run.errors[SOON]) for run in known)
    near = [float(np.mean([run.errors[SOON] <= NEAR for run in runs])) for runs in (known, blank)]
    frame = f"frame {SOON + 1}"
    return [
        Expectation("experts' mean error at the start, px", at_start),
        Expectation(f"{KNOWN}: largest error in {frame}, px", largest, "<=", NEAR),
        Expectation(f"{KNOWN}: runs within {NEAR} px in {frame}, share", near[0], ">=", 1.0),
        Expectation(f"{BLANK}: median error in {frame}, px", float(np.median(by_then))),
        Expectation(f"{BLANK}: median error at the end, px", float(np.median(end))),
        Expectation(f"{BLANK}: runs within {NEAR} px in {frame}, share", near[1]),
    ]


def draw_scattered(
    pictures: Sequence[NDArray[np.uint8]], runs: Mapping[str, Recovery], canvas: Figure
) -> None:
    """Draw vertices of all experts over the pictures, a row for each start."""
    axes = canvas.subplots(len(runs), len(pictures), squeeze=False)
    for row, (start, run) in zip(axes, runs.items(), strict=True):
        for axis, index, picture, vertices in zip(row, SHOWN, pictures, run.vertices, strict=True):
            axis.imshow(picture, cmap="gray", vmin=0, vmax=255)
            axis.plot(*vertices.reshape(-1, 2).T, ".", color="#ff3020", markersize=1.5)
            axis.set(xlim=(0, picture.shape[1] - 1), ylim=(picture.shape[0] - 1, 0), xticks=[], yticks=[])
            axis.set_title(f"{start}, frame {index + 1}: {run.errors[index]:.2g} px", fontsize=9)
            axis.grid(visible=False)


# --- models of the background (section 7.2.3 of the paper) and of self-occlusion, with and without ----------

BACKGROUND_FRAMES = 100
BACKGROUND_EXPERTS = 8
NO_WORSE, BETTER, HALF = 1.02, 0.85, 0.5
PAN = 40.0  # px/s by which the room moves where it does

NONE, SHARED, EXACT = "no background", "shared", "a map per expert"
SEEN, ALL = "self-occlusion handled", "every texel taken for visible"


class PannedScene(FaceScene):
    """Scene whose room moves to the side behind the face."""

    def _render(self, index: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        picture, covered = super()._render(index)
        moved = np.roll(self._room, round(PAN * self.dt * index), axis=1)
        return picture + (1 - covered) * (moved - self._room), covered


RAW = {"local_mean": False, "gain": 0.2}
WEAK, MOVING = "weak texture, raw light", "moving room"
CONDITIONS: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "textured, light taken out": ({}, {}),
    WEAK: ({"texture": 0.3, "light": 0.3}, RAW),
    "textured, raw light": ({"light": 0.3}, RAW),
    MOVING: ({}, {}),
}
"""Settings of the scene and of the tracker, with which backgrounds are compared."""
TURNING: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "turns by 60 degrees": ({"max_yaw": 60.0}, {}),
    "parts that stand off": ({"shields": True}, {}),
}
"""The same, with which self-occlusion is compared."""
COMPARED = {
    **dict.fromkeys(CONDITIONS, (NONE, SHARED, EXACT)),
    **dict.fromkeys(TURNING, (SEEN, ALL)),
}
"""The methods by condition."""


def follow_case(case: tuple[str, str], seed: int) -> dict[str, Evaluation]:
    """Follow one scene from its true first pose with one method; vertices are the mean over the experts."""
    condition, method = case
    settings, tracker = {**CONDITIONS, **TURNING}[condition]
    scene = (PannedScene if condition == MOVING else FaceScene)(BACKGROUND_FRAMES, seed, **settings)
    chain = GFlow(
        scene.model,
        scene.poses[0],
        experts=BACKGROUND_EXPERTS,
        background="experts" if method == EXACT else "shared",
        occlusion=method != ALL,
        recover=False,
        seed=seed,
        **tracker,
    )
    pixels, model = PixelLabels(), MultiChain()
    if method == SHARED:
        model.connect(AdaptiveBackground(), pixels)
    engine, state = RecursiveBP(model.connect(chain, pixels)), RunState()
    vertices, spent = [], 0.0
    for frame in scene:
        begin = time.perf_counter()
        belief = engine.step(state, frame)
        spent += time.perf_counter() - begin
        state = belief.state
        vertices.append(chain.vertices(belief[chain])[0])
    return {method: replace(Evaluation.of(scene, np.array(vertices)), time=1000 * spent / len(scene))}


def face_background() -> Findings:
    """Compare no background, a shared one, and one an expert; and self-occlusion handled and not."""
    cases = [(condition, method) for condition, methods in COMPARED.items() for method in methods]
    found: dict[str, dict[str, list[Evaluation]]] = {condition: {} for condition in COMPARED}
    for (condition, _), evaluations in by_seed("face and background", follow_case, cases, SEEDS).items():
        found[condition].update(evaluations)
    lines = [
        [scene, method, quartiles(evaluations), n_lost(evaluations), f"{median(evaluations, 'time'):.0f}"]
        for scene, methods in found.items()
        for method, evaluations in methods.items()
    ]
    header = ("scene", "method", "error, px", f"lost of {len(SEEDS)}", "ms a frame")
    note = "Medians and quartiles over the scenes; time in one thread, with another run beside it."
    return Findings(
        "Face and background",
        [Table(header, lines, note)],
        over_seeds(expected_of_backgrounds, found),
    )


def expected_of_backgrounds(measured: Mapping[str, Measured]) -> list[Expectation]:
    """Return what is expected of ratios of medians."""

    def over(condition: str, method: str, other: str) -> float:
        return median(measured[condition][method]) / median(measured[condition][other])

    gains = {condition: over(condition, SEEN, ALL) for condition in TURNING}
    return [
        *(
            Expectation(
                f"{condition}: error with {method} over that without",
                over(condition, method, NONE),
                "<=",
                BETTER if condition == WEAK else NO_WORSE,
            )
            for method in (SHARED, EXACT)
            for condition in CONDITIONS
        ),
        *(
            Expectation(f"{condition}: error with self-occlusion handled over that without", gain)
            for condition, gain in gains.items()
        ),
        Expectation("the better of these", min(gains.values()), "<=", HALF),
    ]


# --- a real film: a generic model, and a person's own learned from the film's landmarks ---------------------

PUPILS = (31, 36)  # landmarks between which the distance in the first frame is the unit of errors
OWN_BASES = 6
SURREY, OWN = "Surrey model, 20 experts", f"own model, {OWN_BASES} bases, 20 experts"
LANDMARKS = (
    "Mean distance of the 68 landmarks from the annotated ones, in % of the distance between the pupils in "
    "the first frame. All are attached to the surface where a method starts, and carried by its mean pose."
)


FILM_SEEDS = range(3)  # of the experts, and of noise on the film


@dataclass(frozen=True, eq=False)
class Start:
    """Model and pose of a method's start, and the index of its first frame."""

    face: FaceStart
    first: int


@dataclass(frozen=True, eq=False)
class FilmTrial:
    """Errors of landmarks that were followed through a film."""

    errors: Numbers  # `(n_frames,)` % of the pupils' distance
    lost: int  # frames in which the face was


def talking_face() -> Findings:
    """Track the talking face and measure all 68 landmarks in every annotated frame.

    Raises
    ------
    OSError
        if the film or the model cannot be found.
    """
    folder, surrey = data_folder("talking-face"), data_folder("surrey-face")
    truth = landmarks_of_film(np.load(folder / "landmarks_0000-1999.npy"))
    half = len(truth) // 2
    pairs = read_correspondences(folder / "fgnet_to_ibug.txt")
    own = learn_shape(truth[:half], OWN_BASES).model()
    starts = {
        SURREY: Start(start_from_landmarks(read_model(surrey), truth[0], pairs), 0),
        OWN: Start(start_from_landmarks(own, truth[half]), half),
    }
    measure = partial(follow_landmarks, folder / "franck.webm", truth, starts)
    measured = by_seed("talking face", measure, list(starts), FILM_SEEDS)
    lines = []
    for name, trials in measured.items():
        each = [
            [len(of.errors), of.errors.mean(), *np.percentile(of.errors, (50, 95)), of.errors.max(), of.lost]
            for of in trials[""]
        ]
        lines.append([name, *np.mean(each, axis=0).tolist()])
    header = ("method", "frames", "mean, %", "median, %", "95 %, %", "worst, %", "lost")
    return Findings(
        "A talking face", [Table(header, lines, LANDMARKS)], over_seeds(expected_of_landmarks, measured)
    )


def follow_landmarks(
    film: Path, truth: Numbers, starts: Mapping[str, Start], name: str, seed: int
) -> dict[str, FilmTrial]:
    """Follow landmarks from a start to the end of the truth."""
    unit = np.linalg.norm(truth[0, PUPILS[0]] - truth[0, PUPILS[1]])
    start, first = starts[name].face, starts[name].first
    chain, places, lost = GFlow(start.model, start.pose, seed=seed), [], 0
    engine = RecursiveBP(MultiChain().connect(chain, PixelLabels()))
    with open_source(str(film), start=first + 1, stop=len(truth)) as source:
        for belief in engine.run(noisy(frame, seed) for frame in source):
            state = belief[chain.name]
            places.append(chain.points(state, start.points))
            lost += state.lost
    errors: Numbers = 100 / unit * np.linalg.norm(np.stack(places) - truth[first:], axis=2).mean(axis=1)
    return {"": FilmTrial(errors, lost)}


def expected_of_landmarks(measured: Mapping[str, Mapping[str, Sequence[FilmTrial]]]) -> list[Expectation]:
    """Return what is expected of means over seeds."""
    surrey, own = measured[SURREY][""], measured[OWN][""]
    mean, worst, of_own = (
        float(np.mean([of(each.errors) for each in trials]))
        for trials, of in ((surrey, np.mean), (surrey, np.max), (own, np.mean))
    )
    lost = float(np.mean([each.lost for each in surrey]))
    return [
        Expectation("(a) Surrey model: mean, % of the pupils' distance", mean, "<=", 7.0),
        Expectation("(a) worst frame, %", worst, "<=", 15.0),
        Expectation("(a) frames lost", lost, "<=", 0),
        Expectation("(b) own model, unseen half: mean error, %", of_own, "<=", 5.0),
    ]


def landmarks_of_film(original: NDArray[np.floating]) -> Numbers:
    """Return the annotation, made on the original film of 720x576 px, in px of the public one of half its
    size.
    """
    places = np.asarray(original, np.float64)
    return np.stack([(places[..., 0] + 7.45) / 2, (places[..., 1] - 0.45) / 2], axis=-1)
