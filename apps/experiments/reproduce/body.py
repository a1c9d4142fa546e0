"""Fig. 6 of the RSMCM paper: likelihood sampling with a tracker of flesh, without it, and CONDENSATION."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ....models.core.frame import Frame
from ...body.measures import (
    ELBOWS,
    FOUND,
    HANDS,
    LEAST_OFF,
    OFF,
    SOON,
    BodyTrial,
    coverage,
    pooled,
    recoveries,
)
from ...body.overlay import BodyOverlay
from ...drawing.mosaic import mosaic
from ...io.files import write_image
from ...reports import page
from ...reports.expectations import Expectation, over_seeds
from ...reports.experiment import Experiment, Plot
from ...reports.record import Table
from ...runs.parallel import in_parallel
from ...scenes import signer
from ..trials.body import BodyTracker, on_one_scene

Image = NDArray[np.uint8]

SEEDS = range(10)
N_FRAMES = 120
SCENE: Mapping[str, Any] = {"n_frames": N_FRAMES, "detector_dropout": 0.2}
SHOWN = tuple(range(19, N_FRAMES, 20))
"""Indices of the frames of the figure: every twentieth, as in the paper."""
PICTURE_WIDTH = 520  # px

SAMPLES = 1000
MULTIPLES = (1, 2, 3, 6)
"""Of RSMCM's time a frame, that CONDENSATION is given."""
NEAR = 1.25
"""Ratio of errors below which a tracker comes near to another."""

TIMED_FRAMES, WARM_UP = 30, 5
"""Length of the scenes on which times are taken, and frames that do not count in them."""
TIMED_SAMPLES = (2000, 10_000)
"""Of CONDENSATION; the time of other numbers follows from that of these."""
FEWEST_SAMPLES = 100

RSMCM = BodyTracker("RSMCM", "rsmcm", SAMPLES)
SAMPLER = BodyTracker("likelihood sampler", "sampler", SAMPLES)
FLESH = BodyTracker("flesh tracker alone", "flesh", 0)
CONDENSATION = "CONDENSATION, {}x the time"
IN_FIGURE = (RSMCM.name, SAMPLER.name, *(CONDENSATION.format(times) for times in (1, 3)))

CLOUD_COLOURS = ("#e0a050", "#d07030", "#c0504d", "#803030")
COLOURS = {
    RSMCM.name: "#1f5fa8",
    SAMPLER.name: "#2a8a4b",
    **dict(zip(map(CONDENSATION.format, MULTIPLES), CLOUD_COLOURS, strict=True)),
}
ERRORS = (
    "tracker", "samples", "error, px", "head heights", "median, px", "hands, px", "elbows, px",
    "hands in 3-D, px", "elbows in 3-D, px",
)  # fmt: skip
BEHAVIOUR = (
    "tracker", "hands in 90 % region, %", "effective samples", "ms a frame", "over RSMCM's",
    "a hand off, % of frames", "mis-tracks", f"recovered in {SOON}, %",
)  # fmt: skip
FAIR = (
    "All trackers see the same pictures through the same features and the same likelihood, know the true "
    "lengths of the body, assume the same dynamics, and are given the true pose of the first frame, which "
    "CONDENSATION cannot find by itself. The first frame does not count."
)
NOTE = (
    "Time of a whole frame, features included: the median, in one thread beside another scene, all trackers "
    f"in turns. A mis-track: a hand's error above {OFF:g} head heights in {LEAST_OFF} frames in a row. "
    f"Recovered: below {FOUND:g} within {SOON} frames from the first in which that hand looks like skin."
)

Found = dict[str, list[BodyTrial]]
"""By tracker, one for each seed."""


def reproduce_body(out: Path) -> Experiment:
    """Fig. 6, with what is wanted of it.

    Raises
    ------
    OSError
        if the folder cannot be written to.
    """
    trackers = compared()
    work = [(on_one_scene, (trackers, {**SCENE, "seed": seed}, SHOWN)) for seed in SEEDS]
    trials = in_parallel("body", work)
    found = {tracker.name: [one[place] for one in trials] for place, tracker in enumerate(trackers)}

    expectations = over_seeds(expectations_of, found)
    errors = [[each.name, each.samples or "", *errors_of(found[each.name])] for each in trackers]
    behaviour = [[name, *behaviour_of(one, found[RSMCM.name])] for name, one in found.items()]

    scene = signer(**SCENE, seed=SEEDS[0])
    frames = {index: scene.frame(index) for index in SHOWN}
    reach = scene.body.upper_arm + scene.body.forearm
    sheet = draw_samples(frames, {name: found[name][0] for name in IN_FIGURE}, reach)
    write_image(out / "fig-6.png", sheet)
    caption = f"Mean over {len(SEEDS)} scenes: over time, and over the time that is spent."
    pictures = page.picture(sheet, "Fig. 6: 40 poses of the posterior, over the picture and from the side.")
    return Experiment(
        "Body",
        [
            Table(ERRORS, errors, f"Of the posterior mean, over all frames but the first. {FAIR}"),
            Table(BEHAVIOUR, behaviour, NOTE),
        ],
        expectations,
        plots=[Plot("errors.png", lambda canvas: draw_errors(canvas, found), (12.0, 4.5), caption)],
        sections=[("Poses", [pictures])],
        runs=as_json(trackers, found),
    )


# How many samples take as long


def compared() -> list[BodyTracker]:
    """All trackers; those of CONDENSATION with as many samples as take the time they are given."""
    scenes = [{**SCENE, "n_frames": TIMED_FRAMES, "seed": seed} for seed in SEEDS[:2]]
    trackers = [RSMCM, *(BodyTracker(f"{count}", "condensation", count) for count in TIMED_SAMPLES)]
    timed = in_parallel("times", [(on_one_scene, (trackers, scene)) for scene in scenes])
    rsmcm, few, many = (
        float(np.median([trial.seconds[WARM_UP:] for trial in trials])) for trials in zip(*timed, strict=True)
    )
    counts = [samples_in(times * rsmcm, (few, many)) for times in MULTIPLES]
    clouds = [
        BodyTracker(CONDENSATION.format(times), "condensation", count)
        for times, count in zip(MULTIPLES, counts, strict=True)
    ]
    return [RSMCM, SAMPLER, *clouds, FLESH]


def samples_in(seconds: float, timed: tuple[float, float]) -> int:
    """How many samples CONDENSATION takes in so many seconds a frame, to two digits.

    Parameters
    ----------
    timed
        s that it takes with each of `TIMED_SAMPLES`; in between and beyond, time is linear.
    """
    few, many = timed
    slope = max(many - few, 1e-9) / (TIMED_SAMPLES[1] - TIMED_SAMPLES[0])
    count = max(TIMED_SAMPLES[0] + (seconds - few) / slope, FEWEST_SAMPLES)
    return int(float(f"{count:.2g}"))


# Figures


def errors_of(trials: Sequence[BodyTrial]) -> list[float | str]:
    """A tracker's cells of `ERRORS`, after its name and samples."""
    errors, deep = pooled(trials, "errors"), pooled(trials, "errors_3d")
    heads = np.mean([trial.error / trial.head_height for trial in trials])
    values = (
        errors.mean(),
        heads,
        np.median(errors),
        errors[:, HANDS].mean(),
        errors[:, ELBOWS].mean(),
        deep[:, HANDS].mean(),
        deep[:, ELBOWS].mean(),
    )
    return [_cell(value) for value in values]


def behaviour_of(trials: Sequence[BodyTrial], rsmcm: Sequence[BodyTrial]) -> list[float | str]:
    """A tracker's cells of `BEHAVIOUR`, after its name."""
    recovered, known = recoveries(trials)
    values = (
        100 * coverage(trials),
        np.median(pooled(trials, "effective")),
        1e3 * seconds(trials),
        seconds(trials) / seconds(rsmcm),
        100 * np.mean([trial.off for trial in trials]),
        sum(len(trial.mis_tracks) for trial in trials),
        100 * recovered / known if known else np.nan,
    )
    return [_cell(value) for value in values]


def _cell(value: float | np.floating[Any]) -> float | str:
    return float(value) if np.isfinite(value) else "–"


def error(trials: Sequence[BodyTrial]) -> float:
    """px: mean over hands and elbows, frames and scenes."""
    return float(np.mean([trial.error for trial in trials]))


def seconds(trials: Sequence[BodyTrial]) -> float:
    """Median of a frame."""
    return float(np.median(pooled(trials, "seconds")))


def expectations_of(found: Found) -> list[Expectation]:
    """What is wanted."""
    rsmcm = found[RSMCM.name]
    clouds = [found[CONDENSATION.format(times)] for times in MULTIPLES]
    ratios = [error(cloud) / error(rsmcm) for cloud in clouds]
    times = [seconds(cloud) / seconds(rsmcm) for cloud in clouds]
    near = [time for time, ratio in zip(times, ratios, strict=True) if ratio <= NEAR]
    need = f"time that CONDENSATION needs to come within {NEAR:g} of RSMCM's error, over RSMCM's"
    recovered, known = recoveries(rsmcm)
    covered = coverage(rsmcm)
    return [
        Expectation(
            "error of RSMCM over the likelihood sampler's",
            error(rsmcm) / error(found[SAMPLER.name]),
            "<=",
            0.6,
        ),
        Expectation("error of RSMCM over CONDENSATION's in the same time", 1 / ratios[0], "<=", 0.5),
        Expectation(need if near else f"{need} (more than)", min(near, default=max(times)), ">=", 3.0),
        Expectation(
            f"RSMCM: {known} mis-tracks, recovered within {SOON} frames, share",
            recovered / known if known else 1.0,
            ">=",
            0.95,
        ),
        Expectation("RSMCM: hands within the 90 % region, share", covered, ">=", 0.8),
        Expectation("the same, from above", covered, "<=", 0.97),
    ]


def as_json(trackers: Sequence[BodyTracker], found: Found) -> dict[str, Any]:
    """Every run's measures, by tracker and seed."""
    return {
        tracker.name: {
            "samples": tracker.samples,
            "error": [trial.error for trial in found[tracker.name]],
            "hands": [trial.hands for trial in found[tracker.name]],
            "head_height": [trial.head_height for trial in found[tracker.name]],
            "coverage": [coverage([trial]) for trial in found[tracker.name]],
            "seconds": [seconds([trial]) for trial in found[tracker.name]],
            "off": [trial.off for trial in found[tracker.name]],
            "mis_tracks": [[asdict(one) for one in trial.mis_tracks] for trial in found[tracker.name]],
        }
        for tracker in trackers
    }


def draw_samples(frames: Mapping[int, Frame], trials: Mapping[str, BodyTrial], reach: float) -> Image:
    """Poses drawn from the posteriors, as in the paper: a row for each frame, a column for each tracker.

    Parameters
    ----------
    frames
        by their index.
    trials
        by the tracker's name, with what is shown in these frames.
    reach
        px: of a stretched arm.
    """
    overlay, rows = BodyOverlay(reach), []
    for index, frame in frames.items():
        assert frame.image is not None
        pictures = [
            overlay.draw(frame.image, trial.shown[index], f"error {trial.errors[index].mean():.0f} px")
            for trial in trials.values()
        ]
        rows.append((f"frame {frame.number}", pictures))
    return mosaic(rows, list(trials), PICTURE_WIDTH)


def draw_errors(canvas: Figure, found: Found) -> None:
    """Mean error over time, and over the time that a frame takes."""
    over_time, over_cost = canvas.subplots(1, 2, sharey=True)
    for name, colour in COLOURS.items():
        trials = found[name]
        errors = np.mean([trial.errors.mean(axis=1) for trial in trials], axis=0)
        over_time.plot(np.arange(2, len(errors) + 1), errors[1:], color=colour, linewidth=1.3, label=name)
        over_cost.plot(1e3 * seconds(trials), error(trials), "o", color=colour)
    clouds = [found[CONDENSATION.format(times)] for times in MULTIPLES]
    line = [1e3 * seconds(cloud) for cloud in clouds], [error(cloud) for cloud in clouds]
    over_cost.plot(*line, color=CLOUD_COLOURS[-1], linewidth=1, zorder=0)
    wanted = NEAR * error(found[RSMCM.name])
    over_cost.axhline(wanted, color=COLOURS[RSMCM.name], linestyle="--", linewidth=1)
    over_cost.set_xscale("log")
    over_time.set_yscale("log")
    for scale in (over_cost.xaxis, over_time.yaxis):
        scale.set_major_formatter("{x:g}")
        scale.set_minor_formatter("{x:g}")
    over_time.set_xlabel("frame")
    over_cost.set_xlabel(f"ms a frame (dashed: {NEAR:g} x RSMCM's error)")
    over_time.set_ylabel("mean error of hands and elbows, px")
    over_time.legend(fontsize=8)
