"""Fig. 6 of the RSMCM paper: likelihood sampling with a tracker of flesh, without it, and CONDENSATION.

All of them as filters, and two with hindsight as well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..body.measures import (
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
from ..runs.parallel import in_parallel
from ..scenes import signer
from ..view.overlay import BodyOverlay
from .body_trackers import LAG, BodyTracker, System, on_one_scene
from .expectations import Expectation, over_seeds
from .experiment import Findings, Picture, Plot
from .mosaic import mosaic
from .record import Table

Image = NDArray[np.uint8]

SEEDS = range(20)
N_FRAMES = 120
SCENE: Mapping[str, Any] = {"n_frames": N_FRAMES, "detector_dropout": 0.2}
SHOWN = tuple(range(19, N_FRAMES, 20))
"""Indices of the frames of the figure: every twentieth, as in the paper."""
PICTURE_WIDTH = 520  # px

SAMPLES = 1000
MULTIPLES = (1, 3.2)
"""Of RSMCM's time a frame, hindsight included, that CONDENSATION is given."""
NEAR = 1.25
"""Ratio of errors below which a tracker comes near to another."""

TIMED_FRAMES, WARM_UP = 53, 5
"""Length of the scenes on which times are taken, and frames that do not count in any."""
TIMED_SEEDS = (100, 101)
"""Of these scenes."""
TIMED_SAMPLES: Mapping[System, tuple[int, int]] = {"sampler": (1000, 2000), "condensation": (2000, 10_000)}
"""Of those whose number of samples follows from the time that they are given: that of other numbers follows
from that of these."""
FEWEST_SAMPLES = 100

RSMCM = BodyTracker("RSMCM", "rsmcm", SAMPLES, LAG)
SAMPLER = "likelihood sampler, 1x the time"
FLESH = BodyTracker("flesh tracker alone", "flesh", 0)
CONDENSATION = "CONDENSATION, {}x the time"
CLOUDS = tuple(map(CONDENSATION.format, MULTIPLES))
LATER = f"{{}}, {LAG} frames later"
"""A tracker with hindsight."""
IN_FIGURE = (RSMCM.name, LATER.format(RSMCM.name), SAMPLER, CLOUDS[0])

CLOUD_COLOURS = ("#e0a050", "#803030")
COLOURS = {
    RSMCM.name: "#1f5fa8",
    LATER.format(RSMCM.name): "#6aa8e0",
    SAMPLER: "#2a8a4b",
    **dict(zip(CLOUDS, CLOUD_COLOURS, strict=True)),
}
ERRORS = (
    "tracker", "samples", "error, px", "head heights", "median, px", "hands, px", "elbows, px",
    "hands in 3-D, px", "elbows in 3-D, px",
)  # fmt: skip
BEHAVIOUR = (
    "tracker", "hands in 90 % region, %", "effective samples", "ms a frame", "over RSMCM's",
    "a hand off, % of frames", "mis-tracks", f"recovered in {SOON}, %", f"exchanged > {SOON} frames, scenes",
)  # fmt: skip
FAIR = (
    "All trackers see the same pictures through the same features and the same likelihood, know the true "
    "lengths of the body, assume the same dynamics, and are given the true pose of the first frame, which "
    "CONDENSATION cannot find by itself. The first frame does not count."
)
NOTE = (
    "Time of a whole frame, features included, and hindsight where there is any: the median over stretches "
    f"of {LAG} frames, in one thread beside another scene, all trackers in turns. 1x the time is that of "
    "RSMCM with hindsight, and CONDENSATION's own hindsight comes on top of it. A mis-track: a hand's error "
    f"above {OFF:g} head heights in {LEAST_OFF} frames in a row. Recovered: below {FOUND:g} within {SOON} "
    "frames from the first in which that hand looks like skin."
)

Found = dict[str, list[BodyTrial]]
"""By tracker, one for each seed."""


def body() -> Findings:
    """Fig. 6, with what is wanted of it."""
    trackers = compared()
    work = [(on_one_scene, (trackers, {**SCENE, "seed": seed}, SHOWN)) for seed in SEEDS]
    found = by_name(trackers, in_parallel("body", work))
    expectations = over_seeds(expectations_of, found)
    samples = {name: each.samples for each in trackers for name in (each.name, LATER.format(each.name))}
    errors = [[name, samples[name] or "", *errors_of(trials)] for name, trials in found.items()]
    behaviour = [[name, *behaviour_of(trials, found[RSMCM.name])] for name, trials in found.items()]
    scene = signer(**SCENE, seed=SEEDS[0])
    frames = {index: scene.frame(index) for index in SHOWN}
    reach = scene.body.upper_arm + scene.body.forearm
    sheet = draw_samples(frames, {name: found[name][0] for name in IN_FIGURE}, reach)
    caption = f"Mean over {len(SEEDS)} scenes: over time, and over the time that is spent."
    poses = "Fig. 6: 40 poses of the posterior, over the picture and from the side."
    return Findings(
        "Body",
        [
            Table(ERRORS, errors, f"Of the posterior mean, over all frames but the first. {FAIR}"),
            Table(BEHAVIOUR, behaviour, NOTE),
        ],
        expectations,
        [
            Plot("errors.png", lambda canvas: draw_errors(canvas, found), (12.0, 4.5), caption),
            Picture("fig-6.png", sheet, poses),
        ],
        runs={name: {"samples": samples[name], **as_json(trials)} for name, trials in found.items()},
    )


def by_name(trackers: Sequence[BodyTracker], trials: Sequence[Sequence[BodyTrial]]) -> Found:
    """Trials `[scene][tracker]` by the tracker's name, those with hindsight by one of their own."""
    found: Found = {}
    for tracker, of_scenes in zip(trackers, zip(*trials, strict=True), strict=True):
        found[tracker.name] = list(of_scenes)
        later = [trial.later for trial in of_scenes if trial.later is not None]
        if later:
            found[LATER.format(tracker.name)] = later
    return found


# How many samples take as long


def compared() -> list[BodyTracker]:
    """All trackers; those of `TIMED_SAMPLES` with as many samples as take the time they are given."""
    scenes = [{**SCENE, "n_frames": TIMED_FRAMES, "seed": seed} for seed in TIMED_SEEDS]
    timed = [
        RSMCM,
        *(
            BodyTracker(f"{system} {n}", system, n)
            for system, counts in TIMED_SAMPLES.items()
            for n in counts
        ),
    ]
    found = by_name(timed, in_parallel("times", [(on_one_scene, (timed, scene)) for scene in scenes]))
    times = {name: seconds(trials) for name, trials in found.items()}
    whole = times[LATER.format(RSMCM.name)]

    def given(name: str, system: System, multiple: float, lag: int = 0) -> BodyTracker:
        counts = TIMED_SAMPLES[system]
        few, many = (times[f"{system} {count}"] for count in counts)
        return BodyTracker(name, system, samples_in(multiple * whole, counts, (few, many)), lag)

    clouds = [
        given(name, "condensation", multiple, LAG if multiple == 1 else 0)
        for name, multiple in zip(CLOUDS, MULTIPLES, strict=True)
    ]
    return [RSMCM, given(SAMPLER, "sampler", 1), *clouds, FLESH]


def samples_in(seconds: float, counts: tuple[int, int], timed: tuple[float, float]) -> int:
    """How many samples a tracker takes in so many seconds a frame, to two digits.

    Parameters
    ----------
    counts, timed
        two numbers of samples, and s that it takes with each; in between and beyond, time is linear.
    """
    few, many = timed
    slope = max(many - few, 1e-9) / (counts[1] - counts[0])
    count = max(counts[0] + (seconds - few) / slope, FEWEST_SAMPLES)
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
        exchanged(trials),
    )
    return [_cell(value) for value in values]


def _cell(value: float | np.floating[Any]) -> float | str:
    return float(value) if np.isfinite(value) else "–"


def error(trials: Sequence[BodyTrial]) -> float:
    """px: mean over hands and elbows, frames and scenes."""
    return float(np.mean([trial.error for trial in trials]))


def exchanged(trials: Sequence[BodyTrial]) -> int:
    """Scenes in which the hands are exchanged for long."""
    return sum(trial.longest_exchange > SOON for trial in trials)


def seconds(trials: Sequence[BodyTrial]) -> float:
    """A frame's: median over stretches of frames, since answers with hindsight come several at a time."""
    stretches = [
        trial.seconds[first : first + LAG].mean()
        for trial in trials
        for first in range(WARM_UP, len(trial.seconds) - LAG + 1, LAG)
    ]
    return float(np.median(stretches))


def time_to_come_near(times: Sequence[float], ratios: Sequence[float]) -> float:
    """Time at which a ratio of errors falls to `NEAR`, between the points that were measured; the last one
    if it never does."""
    for place, ratio in enumerate(ratios):
        if ratio <= NEAR:
            if not place:
                return times[0]
            share = (ratios[place - 1] - NEAR) / (ratios[place - 1] - ratio)
            return float(times[place - 1] ** (1 - share) * times[place] ** share)
    return times[-1]


def expectations_of(found: Found) -> list[Expectation]:
    """What is wanted."""
    now, later = found[RSMCM.name], found[LATER.format(RSMCM.name)]
    clouds = [found[name] for name in CLOUDS]
    ratios = [error(cloud) / error(now) for cloud in clouds]
    times = [seconds(cloud) / seconds(now) for cloud in clouds]
    need = f"time in which CONDENSATION comes within {NEAR:g} of RSMCM's error, filtering, over RSMCM's"
    if min(ratios) > NEAR:
        need += " (more than)"
    recovered, known = recoveries(later)
    covered = coverage(later)
    cloud_later = found[LATER.format(CLOUDS[0])]
    hindsight = f"RSMCM, {LAG} frames later"
    return [
        Expectation(
            "error of RSMCM over the likelihood sampler's in the same time, both filtering",
            error(now) / error(found[SAMPLER]),
            "<=",
            0.5,
        ),
        Expectation("over CONDENSATION's in the same time, both filtering", 1 / ratios[0], "<=", 0.7),
        Expectation(
            f"error of {hindsight}, over CONDENSATION's filtering", error(later) / error(clouds[0]), "<=", 0.5
        ),
        Expectation(f"the same over CONDENSATION's {LAG} frames later", error(later) / error(cloud_later)),
        Expectation(need, time_to_come_near(times, ratios), ">=", 3.0),
        Expectation(
            f"{hindsight}: {known} mis-tracks, recovered within {SOON} frames, share",
            recovered / known if known else 1.0,
            ">=",
            0.95,
        ),
        Expectation(f"{hindsight}: hands within the 90 % region, share", covered, ">=", 0.85),
        Expectation("the same, from above", covered, "<=", 0.95),
        Expectation(
            f"{hindsight}: a hand off by {OFF:g} head heights, share of frames",
            float(np.mean([trial.off for trial in later])),
            "<=",
            0.06,
        ),
        Expectation(
            f"{hindsight}: scenes with hands exchanged for more than {SOON} frames", exchanged(later), "<=", 0
        ),
    ]


def as_json(trials: Sequence[BodyTrial]) -> dict[str, Any]:
    """A tracker's measures, by seed."""
    return {
        "error": [trial.error for trial in trials],
        "hands": [trial.hands for trial in trials],
        "head_height": [trial.head_height for trial in trials],
        "coverage": [coverage([trial]) for trial in trials],
        "seconds": [seconds([trial]) for trial in trials],
        "off": [trial.off for trial in trials],
        "longest_exchange": [trial.longest_exchange for trial in trials],
        "mis_tracks": [[asdict(one) for one in trial.mis_tracks] for trial in trials],
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
    clouds = [found[name] for name in CLOUDS]
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
