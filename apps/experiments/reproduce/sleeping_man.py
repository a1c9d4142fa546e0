"""Figs. 1 and 7 of the RSMCM paper: a person who stands still, on generated scenes."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame
from ...drawing.mosaic import mosaic
from ...evaluation.masks import PixelScore, joined, total
from ...runs.progress import Progress
from ...scenes import Scene, sleeping_man
from ..compare import CHAINS, SHOWN_PRIOR, Model
from ..expectations import Expectation, over_seeds
from ..experiment import Experiment, Picture
from ..record import Table
from ..trials.baselines import SETTINGS, CleanUp, Setting, sweep_subtractors

Image = NDArray[np.uint8]

RAW = (CleanUp(), CleanUp(keep_shadows=True))
SEEDS = (0, 1, 2)


def reproduce_sleeping_man(out: Path, long: bool) -> Experiment:
    """Figs. 1 and 7: a person stands still; alone, the background takes them in, together with blobs not.

    Parameters
    ----------
    out
        folder for figures and page.
    long
        also a person standing for 1300 frames, and shadows of clouds.

    Raises
    ------
    OSError
        if the folder cannot be written to.
    """
    pooled: Found = {}
    for seed in SEEDS:
        frames, truth = _rendered(sleeping_man(seed=seed), f"scene {seed}")
        for name, setting, score in _scores_of_scene(frames, truth, SETTINGS):
            pooled.setdefault((name, setting), []).append(score)
    lines: list[list[object]] = []
    for name, (setting, scores) in best_settings(pooled).items():
        lines.append([name, setting, *(score.total().f_measure for score in scores), total(scores).f_measure])
    expectations = over_seeds(expectations_of, pooled)
    if long:
        expectations += _long_expectations()
    header = ("method", "setting", *(f"F, seed {seed}" for seed in SEEDS), "F")
    figures = _sleeping_figures(sleeping_man(seed=SEEDS[0]))
    captions = {"Fig. 1": "the background by itself", "Fig. 7": "background and blobs together"}
    pictures = [
        Picture(f"{name.lower().replace('. ', '-')}.png", image, f"{name}: {captions[name]}")
        for name, image in figures.items()
    ]
    return Experiment("Sleeping man", [Table(header, lines)], expectations, pictures)


Found = dict[tuple[str, str], list[PixelScore]]
"""By method and setting, one for each seed."""


def best_settings(pooled: Found) -> dict[str, tuple[str, list[PixelScore]]]:
    """Of each method, the setting of the greatest F over all scenes, and its scores."""
    best: dict[str, tuple[str, list[PixelScore]]] = {}
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


def _rendered(scene: Scene, label: str) -> tuple[list[Frame], list[NDArray[np.bool_]]]:
    frames, masks = [], []
    with Progress(label, len(scene)) as progress:
        for frame, mask in zip(scene, scene.masks, strict=True):
            frames.append(frame)
            masks.append(mask)
            progress.update()
    return frames, masks


def _scores_of_scene(
    frames: list[Frame], truth: list[NDArray[np.bool_]], settings: Sequence[Setting]
) -> Iterator[tuple[str, str, PixelScore]]:
    """Method, setting and score of everything that is tried on a scene."""
    labels = [np.where(mask, np.uint8(255), np.uint8(0)) for mask in truth]
    size = _size(frames)
    systems = [Model(name, engine, size) for name, engine in CHAINS]
    for system in systems:
        score = PixelScore()
        with Progress(system.name, len(frames)) as progress:
            for frame, label in zip(frames, labels, strict=True):
                score.add(frame.number, system.step(frame).foreground, label)
                progress.update()
        yield system.name, "", score

    def evaluate(number: int, mask: Image) -> PixelScore:
        one = PixelScore()
        one.add(number, mask, labels[number - 1])
        return one

    with Progress("MOG2, KNN", len(frames) * len(settings)) as progress:

        def images() -> Iterator[tuple[int, Image]]:
            for frame in frames:
                assert frame.image is not None
                yield frame.number, frame.image
                progress.update()

        numbers = range(1, len(frames) + 1)
        for row in sweep_subtractors(images, numbers, evaluate, settings, RAW):
            kept = ", shadows kept" if row.clean_up.keep_shadows else ""
            yield row.setting.method, row.setting.parameters + kept, joined(row.values)


def _long_expectations() -> list[Expectation]:
    """Scenes on which nothing was tuned."""
    expectations = []
    for label, scene in (
        ("standing for 1300 frames", sleeping_man(1650, seed=7, stand=1300, car_leaves=1650)),
        ("shadows of clouds", sleeping_man(800, seed=8, clouds=True)),
    ):
        system = Model("RSMCM", "recursive-bp", scene.size)
        score = PixelScore()
        with Progress(label, len(scene)) as progress:
            for frame, mask in zip(scene, scene.masks, strict=True):
                found = system.step(frame).foreground
                score.add(frame.number, found, np.where(mask, np.uint8(255), np.uint8(0)))
                progress.update()
        blocks = [
            scores.f_measure
            for _, scores in score.blocks()
            if scores.true_positives + scores.false_negatives > 0
        ]
        expectations.append(Expectation(f"F, {label}", score.total().f_measure, ">=", 0.95))
        expectations.append(Expectation(f"least F of 250 frames, {label}", min(blocks), ">=", 0.85))
    return expectations


def _sleeping_figures(scene: Scene) -> dict[str, Image]:
    """Figs. 1 and 7: input every thirtieth frame, background, foreground."""
    systems = {
        "Fig. 1": Model("alone", "stand-alone", scene.size, {"background": {"prior": SHOWN_PRIOR}}),
        "Fig. 7": Model("RSMCM", "recursive-bp", scene.size),
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
    return {
        name: mosaic(
            [("input", inputs), ("estimated background", backgrounds), ("foreground", masks)], numbers, 160
        )
        for name, (backgrounds, masks) in made.items()
    }


def _size(frames: Sequence[Frame]) -> tuple[int, int]:
    image = frames[0].image
    assert image is not None
    return image.shape[1], image.shape[0]
