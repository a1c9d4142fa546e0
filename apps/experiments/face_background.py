"""Models of the background (§7.2.3 of its paper) and of self-occlusion in G-flow: errors with and without."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow
from ...chains.pixels.adaptive_background import AdaptiveBackground
from ...inference.engine.graph import MultiChain
from ...inference.engine.recursive_bp import RecursiveBP, RunState
from ...models.pixels.pixel_labels import PixelLabels
from ..scenes import FaceScene, face
from .expectations import Expectation, over_seeds
from .experiment import Findings, Plot, by_seed
from .face_trackers import Evaluation, as_json, median, n_lost, quartiles
from .record import Table

SEEDS = range(10)
N_FRAMES = 100
EXPERTS = 8
NO_WORSE, BETTER, HALF = 1.02, 0.85, 0.5
PAN = 40.0
"""px/s by which the room moves where it does."""

NONE, SHARED, EXACT = "no background", "shared", "a map per expert"
SEEN, ALL = "self-occlusion handled", "every texel taken for visible"
COLOURS = {NONE: "#8a8a8a", SHARED: "#1f5fa8", EXACT: "#2a8a4b", SEEN: "#1f5fa8", ALL: "#8a8a8a"}
LINE = ("scene", "method", "error, px", f"lost of {len(SEEDS)}", "ms a frame")


@dataclass(frozen=True)
class Condition:
    """A scene, and how the tracker is set for it."""

    name: str
    scene: Mapping[str, Any]
    tracker: Mapping[str, Any]
    pans: bool = False

    def sequence(self, seed: int) -> FaceScene:
        """The scene of a seed."""
        made = face(N_FRAMES, seed, **self.scene)
        return PannedScene(**vars(made)) if self.pans else made


class PannedScene(FaceScene):
    """The room moves to the side behind the face."""

    def _drawn(self, index: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        picture, covered = super()._drawn(index)
        moved = np.roll(self._room, round(PAN * self.dt * index), axis=1)
        return picture + (1 - covered) * (moved - self._room), covered


RAW = {"local_mean": False, "gain": 0.2}
WEAK = Condition("weak texture, raw light", {"texture": 0.3, "light": 0.3}, RAW)
CONDITIONS = (
    Condition("textured, light taken out", {}, {}),
    WEAK,
    Condition("textured, raw light", {"light": 0.3}, RAW),
    Condition("moving room", {}, {}, pans=True),
)
TURNING = (
    Condition("turns by 60 degrees", {"max_yaw": 60.0}, {}),
    Condition("parts that stand off", {"shields": True}, {}),
)
COMPARED = tuple((condition, (NONE, SHARED, EXACT)) for condition in CONDITIONS) + tuple(
    (condition, (SEEN, ALL)) for condition in TURNING
)
"""Every condition with the methods that are compared on it."""

Found = dict[str, dict[str, list[Evaluation]]]
"""By condition and method, one evaluation for each seed."""


def run(case: tuple[str, str], seed: int) -> dict[str, Evaluation]:
    """Follow one scene from its true first pose with one method; vertices are the mean over the experts."""
    name, method = case
    condition = next(condition for condition, _ in COMPARED if condition.name == name)
    scene = condition.sequence(seed)
    chain = GFlow(
        scene.model,
        scene.poses[0],
        experts=EXPERTS,
        background="experts" if method == EXACT else "shared",
        occlusion=method != ALL,
        recover=False,
        seed=seed,
        **condition.tracker,
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


def measure(seeds: Sequence[int]) -> Found:
    """Run everything."""
    cases = [(condition.name, method) for condition, methods in COMPARED for method in methods]
    found: Found = {condition.name: {} for condition, _ in COMPARED}
    for (name, _), evaluations in by_seed("face and background", run, cases, seeds).items():
        found[name].update(evaluations)
    return found


def expectations_of(found: Found) -> list[Expectation]:
    """What is wanted of ratios of medians."""

    def ratio(condition: Condition, method: str, other: str) -> float:
        return median(found[condition.name][method]) / median(found[condition.name][other])

    expectations = [
        Expectation(
            f"{condition.name}: error with {method} over that without",
            ratio(condition, method, NONE),
            "<=",
            BETTER if condition is WEAK else NO_WORSE,
        )
        for method in (SHARED, EXACT)
        for condition in CONDITIONS
    ]
    gains = [ratio(condition, SEEN, ALL) for condition in TURNING]
    expectations += [
        Expectation(f"{condition.name}: error with self-occlusion handled over that without", gain)
        for condition, gain in zip(TURNING, gains, strict=True)
    ]
    expectations.append(Expectation("the better of these", min(gains), "<=", HALF))
    return expectations


def face_background() -> Findings:
    """Errors with no background, a shared one, and one an expert; and with self-occlusion handled and not."""
    found = measure(SEEDS)
    lines = [
        [scene, method, quartiles(evaluations), n_lost(evaluations), f"{median(evaluations, 'time'):.0f}"]
        for scene, methods in found.items()
        for method, evaluations in methods.items()
    ]
    caption = f"Mean vertex error in each of {len(SEEDS)} scenes of {N_FRAMES} frames, and the median."
    note = "Medians and quartiles over the scenes; time in one thread, with another run beside it."
    return Findings(
        "Face and background",
        [Table(LINE, lines, note)],
        over_seeds(expectations_of, found),
        [Plot("errors.png", lambda canvas: draw(canvas, found), (12.0, 4.5), caption)],
        runs={scene: as_json(methods) for scene, methods in found.items()},
    )


def draw(canvas: Figure, found: Found) -> None:
    """Error of every run, a plot for each scene."""
    axes = canvas.subplots(1, len(found), sharey=True, squeeze=False)[0]
    for axis, (scene, methods) in zip(axes, found.items(), strict=True):
        for place, (method, evaluations) in enumerate(methods.items()):
            errors = [evaluation.error for evaluation in evaluations]
            aside = place + np.linspace(-0.2, 0.2, len(errors))
            axis.plot(aside, errors, ".", color=COLOURS[method], alpha=0.6)
            axis.hlines(median(evaluations), place - 0.35, place + 0.35, color=COLOURS[method], linewidth=2)
        axis.set_xticks(range(len(methods)), list(methods), rotation=30, ha="right", fontsize=8)
        axis.set_title(scene, fontsize=9)
    axes[0].set_yscale("log")
    axes[0].set_ylabel("mean error of vertices, px")
