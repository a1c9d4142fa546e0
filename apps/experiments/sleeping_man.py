"""Figs. 1 and 7 of the RSMCM paper: a person who stands still, on generated scenes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..evaluation.masks import PixelScore, joined, total
from ..runs.progress import Progress
from ..scenes import Scene
from ..scenes import sleeping_man as street
from .baselines import SETTINGS, CleanUp, Setting, sweep_subtractors
from .compare import CHAINS, SHOWN_PRIOR, Model
from .expectations import Expectation, over_seeds
from .experiment import Findings, Picture, by_seed
from .mosaic import mosaic
from .record import Table

Image = NDArray[np.uint8]

RAW = (CleanUp(), CleanUp(keep_shadows=True))
SEEDS = (0, 1, 2)

Found = Mapping[tuple[str, str], Sequence[PixelScore]]
"""By method and setting, one for each seed."""


def sleeping_man(*, long: bool) -> Findings:
    """Figs. 1 and 7: a person stands still; alone, the background takes them in, together with blobs not.

    Parameters
    ----------
    long
        also a person standing for 1300 frames, and shadows of clouds.
    """
    (pooled,) = by_seed("sleeping man", partial(scores_of, SETTINGS), [None], SEEDS).values()
    lines = [
        [name, setting, *(score.total().f_measure for score in scores), total(scores).f_measure]
        for name, (setting, scores) in best_settings(pooled).items()
    ]
    header = ("method", "setting", *(f"F, seed {seed}" for seed in SEEDS), "F")
    expectations = over_seeds(expectations_of, pooled)
    if long:
        expectations += _long_expectations()
    return Findings("Sleeping man", [Table(header, lines)], expectations, figures(street(seed=SEEDS[0])))


def best_settings(pooled: Found) -> dict[str, tuple[str, Sequence[PixelScore]]]:
    """Of each method, the setting of the greatest F over all scenes, and its scores."""
    best: dict[str, tuple[str, Sequence[PixelScore]]] = {}
    for (name, setting), scores in pooled.items():
        if name not in best or total(scores).f_measure > total(best[name][1]).f_measure:
            best[name] = (setting, scores)
    return best


def expectations_of(pooled: Found) -> list[Expectation]:
    """What is wanted of RSMCM beside the others' best settings."""
    found = {name: total(scores).f_measure for name, (_, scores) in best_settings(pooled).items()}
    return [
        Expectation("F, RSMCM", found["RSMCM"]),
        *(
            Expectation(f"1 - F, RSMCM over {name}", (1 - found["RSMCM"]) / (1 - found[name]), "<=", bound)
            for name, bound in (("feed-forward", 0.35), ("MOG2", 0.3), ("KNN", 0.3))
        ),
    ]


def scores_of(settings: Sequence[Setting], _: object, seed: int) -> dict[tuple[str, str], PixelScore]:
    """Scores of all methods on the scene of a seed, by method and setting."""
    return scores_of_scene(street(seed=seed), settings)


def scores_of_scene(scene: Scene, settings: Sequence[Setting]) -> dict[tuple[str, str], PixelScore]:
    """Scores of the chains, and of OpenCV's subtractors with and without shadows, by method and setting."""
    frames = list(scene)
    labels = [np.where(mask, np.uint8(255), np.uint8(0)) for mask in scene.masks]
    found = {
        (name, ""): _model_score(Model(name, engine, scene.size), frames, labels) for name, engine in CHAINS
    }

    def evaluate(number: int, mask: Image) -> PixelScore:
        one = PixelScore()
        one.add(number, mask, labels[number - 1])
        return one

    images = [(frame.number, frame.image) for frame in frames if frame.image is not None]
    for row in sweep_subtractors(lambda: images, range(1, len(frames) + 1), evaluate, settings, RAW):
        kept = ", shadows kept" if row.clean_up.keep_shadows else ""
        found[row.setting.method, row.setting.parameters + kept] = joined(row.values)
    return found


def _labels(scene: Scene) -> Iterator[Image]:
    """Truth as CDnet has it."""
    return (np.where(mask, np.uint8(255), np.uint8(0)) for mask in scene.masks)


def _model_score(model: Model, frames: Iterable[Frame], labels: Iterable[Image]) -> PixelScore:
    score = PixelScore()
    for frame, label in zip(frames, labels, strict=True):
        score.add(frame.number, model.step(frame).foreground, label)
    return score


def _long_expectations() -> list[Expectation]:
    """Scenes on which nothing was tuned."""
    expectations = []
    for name, scene in (
        ("standing for 1300 frames", street(1650, seed=7, stand=1300, car_leaves=1650)),
        ("shadows of clouds", street(800, seed=8, clouds=True)),
    ):
        score = _model_score(Model("RSMCM", "recursive-bp", scene.size), scene, _labels(scene))
        blocks = [each.f_measure for _, each in score.blocks() if each.true_positives + each.false_negatives]
        expectations.append(Expectation(f"F, {name}", score.total().f_measure, ">=", 0.95))
        expectations.append(Expectation(f"least F of 250 frames, {name}", min(blocks), ">=", 0.85))
    return expectations


def figures(scene: Scene) -> list[Picture]:
    """Figs. 1 and 7: input every thirtieth frame, background, foreground."""
    systems = {
        "Fig. 1: the background by itself": Model(
            "alone", "stand-alone", scene.size, {"background": {"prior": SHOWN_PRIOR}}
        ),
        "Fig. 7: background and blobs together": Model("RSMCM", "recursive-bp", scene.size),
    }
    numbers: list[str] = []
    inputs: list[Image] = []
    made: dict[str, tuple[list[Image], list[Image]]] = {name: ([], []) for name in systems}
    with Progress("figures", len(scene)) as progress:
        for frame in scene:
            assert frame.image is not None
            shown = frame.number % 30 == 0
            for name, system in systems.items():
                found = system.step(frame)
                if shown:
                    made[name][0].append(system.background())
                    made[name][1].append(found.foreground)
            if shown:
                numbers.append(f"frame {frame.number}")
                inputs.append(frame.image)
            progress.update()
    pictures = []
    for name, (backgrounds, masks) in made.items():
        rows = [("input", inputs), ("estimated background", backgrounds), ("foreground", masks)]
        pictures.append(Picture(f"fig-{name[5]}.png", mosaic(rows, numbers, 160), name))
    return pictures
