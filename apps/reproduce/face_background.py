"""Models of the background (§7.2.3 of its paper) and of self-occlusion in G-flow: errors with and without."""

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chains.adaptive_background import AdaptiveBackground
from ...chains.gflow import GFlow
from ...inference.graph import MultiChain
from ...inference.recursive_bp import RecursiveBP
from ...models.pixel_labels import PixelLabels
from .. import report
from ..claims import HEADER, Claim, print_tables
from ..progress import Progress
from ..scenes import FaceScene, face

Array = NDArray[np.float64]

SEEDS = range(10)
N_FRAMES = 100
EXPERTS = 8
LOST = 8.0
"""px of mean vertex error in the last frame from which a run is lost."""
NO_WORSE, BETTER, HALF = 1.02, 0.85, 0.5
MOST_WORKERS = 2
PAN = 40.0
"""px/s by which the room moves where it does."""

NONE, SHARED, EXACT = "no background", "shared", "a map per expert"
SEEN, ALL = "self-occlusion handled", "every texel taken for visible"


@dataclass(frozen=True)
class Setting:
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


WEAK = Setting("weak texture, raw light", {"texture": 0.3, "light": 0.3}, {"local_mean": False, "gain": 0.2})
SETTINGS = (
    Setting("textured, light taken out", {}, {}),
    WEAK,
    Setting("textured, raw light", {"light": 0.3}, {"local_mean": False, "gain": 0.2}),
    Setting("moving room", {}, {}, pans=True),
)
TURNING = (
    Setting("turns by 60 degrees", {"max_yaw": 60.0}, {}),
    Setting("parts that stand off", {"shields": True}, {}),
)


@dataclass(frozen=True)
class Run:
    """Mean vertex error, px, in all frames and in the last one, and ms a frame."""

    error: float
    last: float
    time: float


def run(setting: Setting, method: str, seed: int) -> Run:
    """Follow one scene from its true first pose."""
    scene = setting.sequence(seed)
    chain = GFlow(
        scene.model,
        scene.poses[0],
        experts=EXPERTS,
        background="experts" if method == EXACT else "shared",
        occlusion=method != ALL,
        recover=False,
        seed=seed,
        **setting.tracker,
    )
    pixels, model = PixelLabels(), MultiChain()
    if method == SHARED:
        model.connect(AdaptiveBackground(), pixels)
    engine, state = RecursiveBP(model.connect(chain, pixels)), None
    errors, spent = [], 0.0
    for frame, truth in zip(scene, scene.vertices, strict=True):
        begin = time.perf_counter()
        belief = engine.step(state, frame)
        spent += time.perf_counter() - begin
        state = belief.state
        places = chain.vertices(belief[chain])[0][:, :2]
        errors.append(float(np.linalg.norm(places - truth, axis=1).mean()))
    return Run(float(np.mean(errors[1:])), errors[-1], 1000 * spent / len(errors))


Measured = dict[str, dict[str, list[Run]]]
"""By setting and method, one for each seed."""


def measure(seeds: Sequence[int]) -> Measured:
    """Run everything, in two processes at most."""
    cells = [(setting, method) for setting in SETTINGS for method in (NONE, SHARED, EXACT)]
    cells += [(setting, method) for setting in TURNING for method in (SEEN, ALL)]
    found: Measured = {}
    with (
        ProcessPoolExecutor(min(MOST_WORKERS, os.cpu_count() or 1), get_context("spawn")) as pool,
        Progress("face and background", len(cells) * len(seeds), unit="runs") as progress,
    ):
        futures = {
            pool.submit(run, setting, method, seed): (setting.name, method, seed)
            for setting, method in cells
            for seed in seeds
        }
        done = {}
        try:
            for future in as_completed(futures):
                done[futures[future]] = future.result()
                progress.update()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    for setting, method in cells:
        found.setdefault(setting.name, {})[method] = [done[setting.name, method, seed] for seed in seeds]
    return found


def claims_of(found: Measured) -> list[Claim]:
    """What is wanted of ratios of medians."""

    def ratio(setting: Setting, method: str, other: str) -> float:
        return float(_errors(found[setting.name][method])[1] / _errors(found[setting.name][other])[1])

    claims = []
    for method in (SHARED, EXACT):
        claims += [
            Claim(
                f"{setting.name}: error with {method} over that without",
                ratio(setting, method, NONE),
                "<=",
                most,
            )
            for setting in SETTINGS
            for most in [BETTER if setting is WEAK else NO_WORSE]
        ]
    gains = [ratio(setting, SEEN, ALL) for setting in TURNING]
    claims += [
        Claim(f"{setting.name}: error with self-occlusion handled over that without", gain)
        for setting, gain in zip(TURNING, gains, strict=True)
    ]
    claims.append(Claim("the better of these", min(gains), "<=", HALF))
    return claims


def reproduce_face_background(out: Path) -> None:
    """Errors with no background, a shared one, and one an expert; and with self-occlusion handled and not.

    Raises
    ------
    OSError
        if the folder cannot be written to.
    """
    out.mkdir(parents=True, exist_ok=True)
    found = measure(SEEDS)
    claims = claims_of(found)
    header = ("scene", "method", "error, px", "lost", "ms a frame")
    lines = [
        [name, method, _in_words(runs), str(sum(each.last > LOST for each in runs)), f"{_time(runs):.0f}"]
        for name, methods in found.items()
        for method, runs in methods.items()
    ]
    print_tables(header, lines, claims)
    note = f"Mean vertex error: median (quartiles) of {len(SEEDS)} scenes of {N_FRAMES} frames."
    sections = [
        ("", [report.table(HEADER, [claim.cells for claim in claims])]),
        ("Errors", [report.table(header, lines, note)]),
    ]
    report.write_page(out / "index.html", "Face and background", sections)
    print(f"\npage: {out / 'index.html'}")


def _errors(runs: Sequence[Run]) -> Array:
    quartiles: Array = np.quantile([each.error for each in runs], (0.25, 0.5, 0.75))
    return quartiles


def _time(runs: Sequence[Run]) -> float:
    return float(np.median([each.time for each in runs]))


def _in_words(runs: Sequence[Run]) -> str:
    low, middle, high = _errors(runs)
    return f"{middle:.2f} ({low:.2f}–{high:.2f})"
