"""The page of a body: skeletons over the film and in space, uncertainty of joints, doubts, detections."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...chains.body.hand_labelling import EXCHANGED_PARTS, HandLabels, label_hands
from ...chains.body.samples import WORTH_SAYING
from ...models.body.upper_body import JOINTS, PART_JOINTS, PARTS
from ..io.row_log import RowLog
from ..view.film import Film, Row
from ..view.overlay import TRUNK, BodyOverlay, Draw, TrackedBody, caption, css_colour, skeleton
from ..view.page import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    FrameRecord,
    Line,
    Page,
    Plot,
    Section,
    TimelineRow,
    listed_periods,
    notes_on_missing,
    paragraph,
    periods,
    rates,
    spans_of,
    table,
)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SAME_DOUBT = 0.5  # s: gap within one stretch of doubt, at most
MOST_NAMED = 5  # stretches of doubt that a sentence names
RARELY_SEEN = 0.5  # share of frames with a detection below which a note says that a part is a guess


class Doubt(NamedTuple):
    """First and last frame of a stretch with another hypothesis, and its greatest probability there."""

    first: int
    last: int
    probability: float

    @property
    def frames(self) -> str:
        """In words."""
        return f"{self.first} to {self.last}"


def doubts(numbers: Sequence[int], times: Sequence[float], probabilities: Array) -> list[Doubt]:
    """Return the stretches of frames with a probability of `WORTH_SAYING` or more, but for short gaps."""
    stretches: list[Doubt] = []
    ended = -np.inf  # s
    for index in np.flatnonzero(probabilities >= WORTH_SAYING).tolist():
        one = Doubt(numbers[index], numbers[index], round(float(probabilities[index]), 3))
        if times[index] - ended <= SAME_DOUBT:
            before = stretches.pop()
            one = Doubt(before.first, one.last, max(before.probability, one.probability))
        stretches.append(one)
        ended = times[index]
    return stretches


def describe_doubts(doubts: Mapping[str, Sequence[Doubt]]) -> list[str]:
    """Return a sentence for each kind of doubt, with its longest stretches."""
    sentences = []
    for name, stretches in doubts.items():
        if not stretches:
            continue
        part = name.replace("_", " ")
        what = "hands may be exchanged" if name == "exchanged" else f"{part} may be elsewhere"
        longest = sorted(stretches, key=lambda each: each.first - each.last)[:MOST_NAMED]
        where = ", ".join(f"{each.frames} ({100 * each.probability:.0f} %)" for each in sorted(longest))
        more = len(stretches) - len(longest)
        shorter = f" and {more} shorter stretches" if more else ""
        sentences.append(f"The {what} in frames {where}{shorter}.")
    return sentences


class BodyRecord(FrameRecord):
    """Columns of a run for summary and page.

    Attributes
    ----------
    stationary
        numbers of the frames without any detection.
    log_evidence
        nats, up to a constant; NaN without a detection.
    effective
        effective number of samples, 1 / sum of squared weights.
    places, stds
        a frame each: means `(3, 3)` px of head and hands, and their standard deviations.
    seen
        a frame each: `(3,)`, whether they were detected.
    second
        probability of the second hypothesis.
    unsure
        a frame each: `(3,)`, probability that a part is not where the best hypothesis has it, 0 for the head.
    exchange_log_odds, confusable
        evidence of each frame: log odds of exchanged hands, nats, and the probability that hands could be
        confused.
    """

    def __init__(self, log: RowLog) -> None:
        super().__init__(log)
        self.log_evidence, self.effective = log["log_evidence"], log["effective"]
        self.stationary: list[int] = log["number"][log["stationary"] & ~log["missing"]].tolist()
        self.places = log["joints_3d"][:, PART_JOINTS]
        covariances = log["joints_3d_covariances"][:, PART_JOINTS]
        self.stds = np.sqrt(np.maximum(np.diagonal(covariances, axis1=2, axis2=3), 0))
        self.seen, self.unsure, self.second = log["seen"], log["unsure"], log["hypotheses"][:, 1]
        self.exchange_log_odds, self.confusable = log["exchange_log_odds"], log["confusable"]

    @property
    def shares_seen(self) -> dict[str, float]:
        """Share of the frames with an image in which a part was detected."""
        there = ~np.isin(np.array(self.numbers), self.missing)
        shares = self.of_parts(self.seen)[there].mean(axis=0) if there.any() else np.zeros(len(PARTS))
        return dict(zip(PARTS, map(float, shares), strict=True))

    @property
    def stationary_periods(self) -> list[tuple[int, int]]:
        """First and last frame of every period without any detection."""
        return periods(self.numbers, self.stationary)

    @cached_property
    def labels(self) -> HandLabels:
        """Labels of the hands by the whole film, once it is complete."""
        numbers, times = np.array(self.numbers, np.int64), np.array(self.times)
        return label_hands(numbers, times, self.exchange_log_odds, self.confusable)

    @property
    def exchanged(self) -> Array:
        """Probability of exchanged hands in each frame, after relabelling."""
        labels = self.labels
        return np.where(labels.exchanged, 1 - labels.probabilities, labels.probabilities)

    @property
    def relabelled(self) -> list[tuple[int, int]]:
        """First and last frame of every period whose hands were relabelled."""
        return periods(self.numbers, self.labels.numbers[self.labels.exchanged].tolist())

    def of_parts(self, columns: NDArray[Any]) -> NDArray[Any]:
        """Relabel values `(n, 3, ...)` of head and hands."""
        values = np.array(columns)
        chosen = self.labels.exchanged
        values[chosen] = values[chosen][:, EXCHANGED_PARTS]
        return values

    @property
    def doubts(self) -> dict[str, list[Doubt]]:
        """Stretches in which hands may be exchanged, or one of them elsewhere."""
        probabilities = {"exchanged": self.exchanged}
        unsure = self.of_parts(self.unsure)
        probabilities |= {PARTS[hand]: unsure[:, hand] for hand in (1, 2)}
        return {name: doubts(self.numbers, self.times, each) for name, each in probabilities.items()}

    @property
    def notes(self) -> list[str]:
        """Warnings, a sentence each."""
        notes = [*notes_on_missing(self.missing), *describe_doubts(self.doubts)]
        if self.relabelled:
            notes.append(
                "Given the whole video, left and right hand were relabelled in "
                f"{listed_periods(self.relabelled)}."
            )
        if self.stationary:
            notes.append(
                f"Nothing of the body was detected, and it was only predicted, in "
                f"{listed_periods(self.stationary_periods)}."
            )
        for name, share in self.shares_seen.items():
            if share < RARELY_SEEN:
                hidden = "seen" if name == "head" else "seen, or not separable from the face,"
                notes.append(
                    f"The {name.replace('_', ' ')} was not {hidden} in {100 * (1 - share):.0f} % of the "
                    "frames: its position there is predicted from its motion and the rest of the body."
                )
        return notes


SAMPLES = 12  # poses of the posterior that are drawn in a frame
PER_PX = 4  # units of their positions per px
HALF_90 = 1.645  # standard deviations of a Gaussian to either side of its mean that hold 90 %
COLOURS = (GREEN, BLUE, ORANGE)  # of head, left and right hand
GREY = "#8a929e"  # on the page, of what is white on the images


DRAWN = (
    "joints_3d", "joints_3d_covariances", "samples", "hypotheses", "hypothesis_joints", "seen", "missing",
)  # fmt: skip
"""Columns of `poses.npz` that are drawn."""


def view_row_of(row: Mapping[str, Any]) -> Row:
    """Return the columns that are drawn of a frame, from its row of `poses.npz`."""
    covariances = row["joints_3d_covariances"]
    upper = covariances[:, *np.triu_indices(3)]
    every = len(row["samples"]) // SAMPLES
    samples = row["samples"][::every][:SAMPLES]
    return {
        "joints": np.concatenate([row["joints_3d"], upper], axis=1).astype(np.float32),
        "samples": _whole(samples),
        "second": _whole(row["hypothesis_joints"][1]),
        "secondWeight": row["hypotheses"][1:2].astype(np.float32),
        "seen": row["seen"][None],
        "missing": row["missing"][None],
    }


def _whole(places: NDArray[Any]) -> NDArray[np.int16]:
    """Round places to units of 1 / `PER_PX` px; NaN becomes 0."""
    limits = np.iinfo(np.int16)
    scaled = np.nan_to_num(np.rint(PER_PX * places), nan=0.0)
    return np.asarray(np.clip(scaled, limits.min, limits.max).astype(np.int16))


def with_final_names(film: Film, rows: Mapping[str, NDArray[Any]]) -> Film:
    """Relabel the hands of a film with rows of `view_row_of`, as in `rows` of `poses.npz`."""
    columns = {name: values.copy() for name, values in film.columns.items()}
    for index, place in enumerate(np.searchsorted(rows["frames"], film.numbers)):
        if rows["relabelled"][place]:
            for name, values in view_row_of({name: rows[name][place] for name in DRAWN}).items():
                columns[name].reshape(len(film.numbers), -1)[index] = values.reshape(-1)
    return replace(film, columns=columns)


def drawing(arm: float) -> Draw:
    """Return what draws rows of `view_row_of` on frames; `arm` px is the length of a stretched arm."""
    overlay = BodyOverlay(arm)

    def draw(image: Image, row: Row, number: int, time: float, *, missing: bool) -> Image:
        return overlay.draw(image, _tracked(row), caption(number, missing=missing))

    return draw


def _tracked(row: Row) -> TrackedBody:
    """Read a row of `view_row_of`."""
    joints = row["joints"].astype(np.float64)
    covariances = np.empty((len(joints), 3, 3))
    for k, (r, s) in enumerate(zip(*np.triu_indices(3), strict=True)):
        covariances[:, r, s] = covariances[:, s, r] = joints[:, 3 + k]
    seen = row["seen"][0]
    unseen = [f"{name.replace('_', ' ')} not seen" for name, so in zip(PARTS, seen, strict=True) if not so]
    remarks = [] if row["missing"][0] else unseen if seen.any() else ["nothing seen"]
    weight, second = float(row["secondWeight"][0]), None
    if weight >= WORTH_SAYING:
        second = row["second"] / PER_PX
        remarks.append(f"or as dashed, {100 * weight:.0f} %")
    samples = row["samples"].reshape(-1, *joints[:, :3].shape) / PER_PX
    return TrackedBody(samples, joints[:, :3], covariances, ", ".join(remarks), second)


def body_page(
    title: str, record: BodyRecord, summary: Mapping[str, Any], film: Film | None, arm: float
) -> Page:
    """Return the page of a run of at least one frame.

    The film has columns of `view_row_of`; `arm` is the length of a stretched one, px.
    """
    layers, timeline = ({}, []) if film is None else over_the_film(film, arm)
    return record.page(
        title,
        summary,
        film,
        cards=_cards(summary),
        layers=layers,
        timeline=timeline,
        plots=_plots(record),
        sections=_sections(record, summary),
    )


def over_the_film(film: Film, arm: float) -> tuple[dict[str, Any], list[TimelineRow]]:
    """Return the layer over a film and in space, and a row of the timeline for each joint."""
    columns = film.columns
    seen = columns["seen"] & ~columns["missing"][:, None]
    inks = dict.fromkeys(range(len(JOINTS)), GREY)
    bones = []
    for colour, chain in skeleton():
        ink = GREY if colour == TRUNK else css_colour(colour)
        bones += [(*bone, ink) for bone in pairwise(chain)]
        if colour != TRUNK:
            inks.update(dict.fromkeys(chain, ink))
    rows = []
    for joint in sorted(inks, key=lambda joint: joint not in PART_JOINTS):
        there = seen[:, PART_JOINTS.index(joint)] if joint in PART_JOINTS else np.zeros(len(seen), np.bool_)
        rows.append(TimelineRow(joint, JOINTS[joint].replace("_", " "), inks[joint], spans_of(there)))
    joints = columns["joints"].reshape(len(seen), len(JOINTS), -1)
    low, high = np.quantile(joints[..., :3], (0.02, 0.98), axis=(0, 1))
    layer = {
        "joints": columns["joints"],
        "samples": columns["samples"],
        "second": columns["second"],
        "secondWeight": columns["secondWeight"],
        "worthSaying": WORTH_SAYING,
        "perPx": PER_PX,
        "bones": bones,
        "colours": [inks[joint] for joint in range(len(JOINTS))],
        "parts": PART_JOINTS,
        "seen": seen,
        "arm": arm,
        "centre": [*((low[:2] + high[:2]) / 2).tolist(), 0.0],
        "reach": 1.2 * float(max(*(high - low)[:2] / 2, *np.abs([low[2], high[2]]))),
    }
    return {"body": layer}, rows


def _cards(summary: Mapping[str, Any]) -> dict[str, str]:
    seen = {
        f"{name.replace('_', ' ')} seen": f"{100 * share:.0f} %" for name, share in summary["seen"].items()
    }
    return {
        "frames": f"{summary['frames']}",
        "frames a second": f"{summary['frames_per_second']:.1f}",
        "frames a second, tracker": f"{summary['frames_per_second_of_engine']:.1f}",
        **seen,
        "missing": f"{summary['missing_frames']}",
        "samples": f"{summary['parameters']['samples']}",
    }


def _plots(record: BodyRecord) -> list[Plot]:
    """Return the plots, in which periods without any detection are shaded."""
    nothing = record.spans(record.stationary_periods)

    def plot(name: str, unit: str, lines: Sequence[Line], caption: str) -> Plot:
        return Plot(name, unit, lines, caption + " Shaded: nothing was seen." * bool(nothing), shaded=nothing)

    names = [name.replace("_", " ") for name in PARTS]
    places, halves = record.of_parts(record.places), HALF_90 * record.of_parts(record.stds)
    plots = []
    for axis, name in enumerate(("x, to the right", "y, down", "z, away")):
        lines = []
        for part, colour in enumerate(COLOURS):
            mean, half = places[:, part, axis], halves[:, part, axis]
            lines.append(Line(mean, names[part], colour, (mean - half, mean + half)))
        plots.append(plot(name, "px", lines, "Posterior means, with bands that hold 90 % of a Gaussian."))
    unsure = record.of_parts(record.unsure)
    doubt = [
        Line(100 * np.array(record.second), "second answer", RED),
        *(Line(100 * unsure[:, hand], f"{names[hand]} elsewhere", COLOURS[hand]) for hand in (1, 2)),
        Line(100 * record.exchanged, "hands exchanged", GREEN),
    ]
    caption = (
        "Poses grouped by the positions of their hands: the probability of the second best group, of groups "
        "with a hand at another position than in the best one, and, given the whole video, that left and "
        "right are exchanged."
    )
    return [
        *plots,
        plot("doubt", "%", doubt, caption),
        plot(
            "log evidence",
            "nats",
            [Line(np.array(record.log_evidence))],
            "Log of the mean likelihood of a frame under its samples, up to a constant.",
        ),
        plot("log₁₀ of samples, effective", "", [Line(np.log10(record.effective))], "Of 1 / Σ weight²."),
        Plot("frames a second, tracker", "", [Line(rates(record.seconds))], shaded=nothing),
    ]


def _sections(record: BodyRecord, summary: Mapping[str, Any]) -> list[Section]:
    seen, body = record.of_parts(record.seen), summary["body"]
    shown = [
        (name.replace("_", " "), int(np.count_nonzero(seen[:, part])), f"{100 * share:.1f} %")
        for part, (name, share) in enumerate(record.shares_seen.items())
    ]
    doubts = [
        (name.replace("_", " "), each.frames, f"{100 * each.probability:.0f} %")
        for name, stretches in record.doubts.items()
        for each in stretches
    ]
    lengths = [(name.replace("_", " "), value) for name, value in body["lengths"].items()]
    caption = (
        "Hands in front of face or neck are not counted, since the detected skin may be that of the face."
    )
    sections: list[Section] = [
        (
            "Head and hands",
            [table(("part", "frames in which it was seen", "of those that are not missing"), shown, caption)],
        )
    ]
    if doubts:
        sections.append(("Doubt", [table(("what", "frames", "probability at most"), doubts)]))
    sections.append(("Body", [paragraph(body["origin"]), table(("length", "px"), lengths)]))
    return sections
