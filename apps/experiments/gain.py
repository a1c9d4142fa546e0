"""Fig. 3b of the G-flow paper: from template to flow, and gains that each texel learns for itself."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .expectations import Expectation, over_seeds
from .experiment import Findings, Plot, by_seed
from .face_trackers import Measured, Tracker, as_json, median, n_lost, on_one_scene, quartiles
from .record import Table

SEEDS = range(10)
GAINS = (0.001, 0.01, 0.1, 0.5, 0.999)
TEXELS = 800

STEADY = "constant texture"
CHANGING = "texture that changes"
SCENES: Mapping[str, Mapping[str, Any]] = {
    STEADY: {"n_frames": 200, "motion": "fast", "light": 0.0},
    CHANGING: {"n_frames": 200, "motion": "fast", "light": 0.0, "change": 30.0},
}
"""In even light: a lamp that moves would change what texels look like in both."""
COLOURS = {STEADY: "#1f5fa8", CHANGING: "#c98a2b"}

LEARNED = "learned"
TOLERANCE = 1.1
LINE = ("scene", "gain", "error, px", "error in 3-D, px", f"lost of {len(SEEDS)}")


def trackers() -> list[Tracker]:
    """Twenty experts on a dense texture; the temperature is the same for all gains."""
    gains: list[float | str] = [*GAINS, LEARNED]
    return [Tracker(_name(gain), {"gain": gain, "texels": TEXELS}) for gain in gains]


def _name(gain: float | str) -> str:
    return gain if isinstance(gain, str) else f"{gain:g}"


def gain() -> Findings:
    """Fig. 3b, with what is wanted of it."""
    everything = by_seed("gain", partial(on_one_scene, trackers(), SCENES), list(SCENES), SEEDS)
    lines = [
        [scene, gain, quartiles(evaluations), quartiles(evaluations, "error_3d"), n_lost(evaluations)]
        for scene, found in everything.items()
        for gain, evaluations in found.items()
    ]
    caption = (
        f"Fig. 3b: error of the mean pose's vertices over the gain, median and quartiles of {len(SEEDS)} "
        "sequences; dashed, gains learned by each texel."
    )
    return Findings(
        "Gain",
        [Table(LINE, lines, "Medians and quartiles over the sequences.")],
        over_seeds(expectations_of, everything),
        [Plot("fig-3b.png", lambda canvas: draw(canvas, everything), (8.0, 4.5), caption)],
        runs={scene: as_json(found) for scene, found in everything.items()},
    )


def best_gain(found: Measured) -> float:
    """The fixed gain of the least median error."""
    return min(GAINS, key=lambda gain: median(found[_name(gain)]))


def expectations_of(everything: Mapping[str, Measured]) -> list[Expectation]:
    """What is wanted; of ratios of medians."""
    steady, changing = everything[STEADY], everything[CHANGING]
    best = {scene: median(found[_name(best_gain(found))]) for scene, found in everything.items()}
    return [
        Expectation(
            f"{STEADY}: error of flow (gain {GAINS[-1]:g}) over that of the best gain",
            median(steady[_name(GAINS[-1])]) / best[STEADY],
            ">=",
            2.0,
        ),
        Expectation(f"{STEADY}: best gain", best_gain(steady)),
        Expectation(
            f"{CHANGING}: best gain over that of constant texture",
            best_gain(changing) / best_gain(steady),
            ">=",
            2.0,
        ),
        *(
            Expectation(
                f"{scene}: error with learned gains over that of the best fixed gain",
                median(found[LEARNED]) / best[scene],
                "<=",
                TOLERANCE,
            )
            for scene, found in everything.items()
        ),
    ]


def draw(canvas: Figure, everything: Mapping[str, Measured]) -> None:
    """Error over the gain, on a scale of its log odds, so that both ends are seen."""
    axis = canvas.add_subplot()
    places = np.log(np.array(GAINS) / (1 - np.array(GAINS)))
    for scene, found in everything.items():
        errors = [[evaluation.error for evaluation in found[_name(gain)]] for gain in GAINS]
        low, middle, high = np.percentile(errors, [25, 50, 75], axis=1)
        axis.plot(places, middle, "o-", color=COLOURS[scene], linewidth=1.4, label=scene)
        axis.fill_between(places, low, high, color=COLOURS[scene], alpha=0.2, linewidth=0)
        axis.axhline(median(found[LEARNED]), color=COLOURS[scene], linewidth=1.2, linestyle="--")
    axis.set_xticks(places, [f"{gain:g}" for gain in GAINS])
    axis.set_yscale("log")
    axis.set_xlabel("gain in the steady state: template to flow")
    axis.set_ylabel("mean error of vertices, px")
    axis.legend(fontsize=9)
