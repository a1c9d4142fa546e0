"""Masks beside the truth: a generated person who stands still (Figs. 1 and 7 of the RSMCM paper), and a
film.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..evaluation.masks import PixelScore, total
from ..io.ground_truth import MaskTruth, read_ground_truth
from ..io.sources.open_source import open_source
from ..runs.progress import Progress
from ..scenes import Scene
from ..scenes import sleeping_man as street
from .baselines import CleanUp, Setting
from .compare import CHAINS, SHOWN_PRIOR, BaselineTracker, Model
from .datasets import data_folder
from .experiment import Findings, Plot, by_seed, noisy, pictures
from .record import Expectation, Table, over_seeds

Image = NDArray[np.uint8]

SEEDS = (0, 1, 2)
SETTINGS = (
    Setting("MOG2", 200, 16, CleanUp(keep_shadows=True)),
    Setting("KNN", 200, 400, CleanUp(keep_shadows=True)),
)
"""Those with the greatest F over these scenes, of histories of 100 to 1000 frames and thresholds over a
factor of eight, with shadows and without (tried in November 2026)."""

ScoresByMethod = Mapping[tuple[str, str], Sequence[PixelScore]]  # by method and setting, one for each seed


def sleeping_man(*, long: bool) -> Findings:
    """Run Figs. 1 and 7: a person stands still, with the background alone and with the blob tracker.

    Parameters
    ----------
    long
        also a person standing for 1300 frames, and shadows of clouds.
    """
    (scored,) = by_seed("sleeping man", scores_of, [None], SEEDS).values()
    lines = [
        [*method, *(score.total().f_measure for score in scores), total(scores).f_measure]
        for method, scores in scored.items()
    ]
    header = ("method", "setting", *(f"F, seed {seed}" for seed in SEEDS), "F")
    expectations = over_seeds(expectations_of, scored)
    if long:
        expectations += over_seeds(
            expectations_of_long, by_seed("long scenes", _score_of_long, list(LONG), LONG_SEEDS)
        )
    return Findings("Sleeping man", [Table(header, lines)], expectations, figures(street(seed=SEEDS[0])))


def expectations_of(scored: ScoresByMethod) -> list[Expectation]:
    """Return what is expected of RSMCM beside the others."""
    found = {name: total(scores).f_measure for (name, _), scores in scored.items()}
    return [
        Expectation("F, RSMCM", found["RSMCM"]),
        *(
            Expectation(f"1 - F, RSMCM over {name}", (1 - found["RSMCM"]) / (1 - found[name]), "<=", bound)
            for name, bound in (("feed-forward", 0.35), ("MOG2", 0.3), ("KNN", 0.3))
        ),
    ]


def scores_of(_: object, seed: int) -> dict[tuple[str, str], PixelScore]:
    """Return scores of the chains and of OpenCV's subtractors on the scene of a seed."""
    return scores_of_scene(street(seed=seed))


def scores_of_scene(scene: Scene) -> dict[tuple[str, str], PixelScore]:
    """Return scores of the chains and of OpenCV's subtractors, by method and setting."""
    frames, masks = list(scene), list(scene.masks)
    found = {(name, ""): _score(Model(name, engine, scene.size), frames, masks) for name, engine in CHAINS}
    for each in SETTINGS:
        usual = BaselineTracker(each.method, each, scene.size)
        found[each.method, str(each)] = _score(usual, frames, masks)
    return found


def _score(
    method: Model | BaselineTracker, frames: Iterable[Frame], masks: Iterable[NDArray[np.bool_]]
) -> PixelScore:
    score = PixelScore()
    for frame, mask in zip(frames, masks, strict=True):
        labels = np.where(mask, np.uint8(255), np.uint8(0))  # as CDnet has them
        score.add(frame.number, method.step(frame).foreground, labels)
    return score


LONG_SEEDS = (7, 8, 9)
LONG: Mapping[str, Mapping[str, Any]] = {
    "standing for 1300 frames": {"n_frames": 1650, "stand": 1300, "car_leaves": 1650},
    "shadows of clouds": {"n_frames": 800, "clouds": True},
}
"""Scenes on which nothing was tuned."""


def _score_of_long(name: str, seed: int) -> dict[str, PixelScore]:
    scene = street(**LONG[name], seed=seed)
    return {"RSMCM": _score(Model("RSMCM", "recursive-bp", scene.size), scene, scene.masks)}


def expectations_of_long(measured: Mapping[str, Mapping[str, Sequence[PixelScore]]]) -> list[Expectation]:
    """Return what is expected of long scenes: of all their frames, and of the worst 250 in a row."""
    expectations = []
    for name, scores in measured.items():
        least = [
            min(each.f_measure for _, each in score.blocks() if each.true_positives + each.false_negatives)
            for score in scores["RSMCM"]
        ]
        expectations.append(Expectation(f"F, {name}", total(scores["RSMCM"]).f_measure, ">=", 0.95))
        expectations.append(Expectation(f"least F of 250 frames, {name}", float(np.mean(least)), ">=", 0.85))
    return expectations


def figures(scene: Scene) -> list[Plot]:
    """Make Figs. 1 and 7: input every thirtieth frame, background, foreground."""
    alone = Model("alone", "stand-alone", scene.size, {"background": {"prior": SHOWN_PRIOR}})
    systems = {
        "Fig. 1: the background by itself": alone,
        "Fig. 7: background and blobs together": Model("RSMCM", "recursive-bp", scene.size),
    }
    plots = []
    with Progress("figures", 2 * len(scene)) as progress:
        for name, system in systems.items():
            rows: list[tuple[str, list[Image]]] = [
                ("input", []),
                ("estimated background", []),
                ("foreground", []),
            ]
            for frame in scene:
                found = system.step(frame)
                if frame.number % 30 == 0 and frame.image is not None:
                    made = (frame.image, system.background(), found.foreground)
                    for (_, row), picture in zip(rows, made, strict=True):
                        row.append(picture)
                progress.update()
            columns = [f"frame {number}" for number in range(30, len(scene) + 1, 30)]
            plots.append(pictures(f"fig-{name[5]}.png", rows, columns, name, 1.5))
    return plots


CLEAN_UPS = {"raw": CleanUp(), "5x5 median": CleanUp(median=5)}


def highway() -> Findings:
    """Score the foreground of CDnet's highway with noise by its masks, raw and after a 5x5 median.

    Raises
    ------
    OSError
        if the sequence cannot be found.
    """
    folder = data_folder("cdnet-highway")
    (scores,) = by_seed("highway", partial(scores_of_film, folder), [None], SEEDS).values()
    pooled = {key: total(each) for key, each in scores.items()}
    lines = [[*key, each.precision, each.recall, each.f_measure] for key, each in pooled.items()]
    table = Table(("method", "clean-up", "precision", "recall", "F"), lines)
    return Findings("CDnet highway", [table], over_seeds(expectations_of_film, scores))


def scores_of_film(folder: Path, _: object, seed: int) -> dict[tuple[str, str], PixelScore]:
    """Return scores of the chains on a folder of CDnet with noise, by method and clean-up."""
    truth = read_ground_truth(folder)
    assert isinstance(truth, MaskTruth)
    with open_source(str(folder / "input")) as source:
        models = [Model(name, engine, source.size) for name, engine in CHAINS]
        scores = {(model.name, name): PixelScore() for model in models for name in CLEAN_UPS}
        for frame in source:
            for model in models:
                mask = model.step(noisy(frame, seed)).foreground
                if frame.image is not None and frame.number in truth:
                    labels = truth.labels(frame.number)
                    for name, clean_up in CLEAN_UPS.items():
                        scores[model.name, name].add(frame.number, clean_up.apply(mask), labels)
    return scores


def expectations_of_film(scores: ScoresByMethod) -> list[Expectation]:
    """Return what is expected of F with feedback."""
    return [
        Expectation("F, raw", total(scores["RSMCM", "raw"]).f_measure, ">=", 0.93),
        Expectation("F, after a 5x5 median", total(scores["RSMCM", "5x5 median"]).f_measure, ">=", 0.955),
    ]
