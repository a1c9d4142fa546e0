"""The report of a body-tracking run as one page: pictures, head and hands over time, what was seen."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...chains.body.hand_labelling import ExchangeEvidence, HandLabels, hand_labels
from ...chains.body.samples import BodyMoments, BodySamples
from ...models.body.upper_body import JOINTS, PARTS
from ...models.core.frame import Frame
from ..reports.frame_lists import listed_periods, periods
from ..reports.page import Section, cards, paragraph, table, write_run_page
from ..reports.plots import figure
from ..reports.snapshots import Snapshots
from ..reports.time_plots import BLUE, GREEN, ORANGE, RED, Line, over_time
from ..runs.frame_record import FrameRecord
from .hypotheses import WORTH_SAYING, Hypotheses
from .relabelling import EXCHANGED_PARTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

HALF_90 = 1.645
"""Standard deviations of a Gaussian to either side of its mean that hold 90 %."""

COLOURS = (GREEN, BLUE, ORANGE)
"""Of head, left and right hand, as in the pictures but for the head."""

PICTURE_WIDTH = 960  # px: two views beside each other

PART_JOINTS = [JOINTS.index(name) for name in PARTS]

SAME_DOUBT = 0.5
"""s: doubt that comes again so soon is the same."""

MOST_SAID = 5
"""Stretches of doubt that a sentence names."""

RARELY_SEEN = 0.5
"""Share of the frames below which a part's position is mostly a guess, and said to be one."""


class Doubt(NamedTuple):
    """First and last frame of a stretch with another answer, and its greatest probability there."""

    first: int
    last: int
    probability: float

    @property
    def frames(self) -> str:
        """In words."""
        return f"{self.first} to {self.last}"


def doubts(numbers: Sequence[int], times: Sequence[float], probabilities: Array) -> list[Doubt]:
    """Stretches of frames in which something is probable enough to be said, but for gaps of a moment."""
    found: list[Doubt] = []
    ended = -np.inf  # s
    for index in np.flatnonzero(probabilities >= WORTH_SAYING).tolist():
        one = Doubt(numbers[index], numbers[index], round(float(probabilities[index]), 3))
        if times[index] - ended <= SAME_DOUBT:
            before = found.pop()
            one = Doubt(before.first, one.last, max(before.probability, one.probability))
        found.append(one)
        ended = times[index]
    return found


def in_words(found: Mapping[str, Sequence[Doubt]]) -> list[str]:
    """A sentence for each kind of doubt that there is, the longest stretches first where they are many."""
    sentences = []
    for name, stretches in found.items():
        if not stretches:
            continue
        part = name.replace("_", " ")
        what = "hands may be exchanged" if name == "exchanged" else f"{part} may be elsewhere"
        longest = sorted(stretches, key=lambda each: each.first - each.last)[:MOST_SAID]
        where = ", ".join(f"{each.frames} ({100 * each.probability:.0f} %)" for each in sorted(longest))
        more = len(stretches) - len(longest)
        shorter = f" and {more} shorter stretches" if more else ""
        sentences.append(f"The {what} in frames {where}{shorter}.")
    return sentences


@dataclass(eq=False, kw_only=True)
class BodyRecord(FrameRecord):
    """What summary and report need of a run, gathered frame by frame: a few numbers each, and some pictures.

    Parameters
    ----------
    log_evidence
        nats, up to a constant; NaN where nothing was to be seen.
    effective
        effective number of samples, 1 / sum of squared weights.
    places, spreads
        a frame each: means `(3, 3)` px of head and hands, and their standard deviations.
    seen
        a frame each: `(3,)`, whether the image has shown them.
    second
        probability of the second answer.
    unsure
        a frame each: `(3,)`, probability that a part is elsewhere than in the best answer, 0 for the head.
    exchange_log_odds, confusable
        what each frame says of the names of the hands: log odds, nats, that they are exchanged, and the
        probability that they could be confused.
    stationary
        numbers of the frames whose image has shown nothing of the body.
    """

    log_evidence: "array[float]" = field(default_factory=lambda: array("d"))
    effective: "array[float]" = field(default_factory=lambda: array("d"))
    places: list[Array] = field(default_factory=list)
    spreads: list[Array] = field(default_factory=list)
    seen: list[Mask] = field(default_factory=list)
    second: "array[float]" = field(default_factory=lambda: array("d"))
    unsure: list[Array] = field(default_factory=list)
    exchange_log_odds: "array[float]" = field(default_factory=lambda: array("d"))
    confusable: "array[float]" = field(default_factory=lambda: array("d"))
    stationary: list[int] = field(default_factory=list)
    snapshots: Snapshots = field(default_factory=lambda: Snapshots(PICTURE_WIDTH))

    def add(
        self,
        frame: Frame,
        found: BodyMoments,
        seen: Mask,
        filtered: BodySamples,
        answers: Hypotheses,
        names: ExchangeEvidence,
        seconds: float,
        *,
        overlay: Callable[[], Image],
    ) -> None:
        """Take in a frame; `overlay` is called for the few frames of which a picture is kept."""
        nothing = frame.missing or filtered.stationary
        self.numbers.append(frame.number)
        self.times.append(frame.time)
        self.log_evidence.append(np.nan if nothing else filtered.log_evidence)
        self.effective.append(filtered.effective)
        self.seconds.append(seconds)
        self.places.append(found.joints[PART_JOINTS])
        variances = np.diagonal(found.joint_covariances[PART_JOINTS], axis1=1, axis2=2)
        self.spreads.append(np.sqrt(np.maximum(variances, 0)))
        self.seen.append(seen)
        self.second.append(float(answers.weights[1]))
        self.unsure.append(np.concatenate([[0.0], answers.unsure]))
        self.exchange_log_odds.append(names.log_odds)
        self.confusable.append(names.confusable)
        if frame.missing:
            self.missing.append(frame.number)
        elif filtered.stationary:
            self.stationary.append(frame.number)
        self.snapshots.add(frame, overlay)

    @property
    def shares_seen(self) -> dict[str, float]:
        """Of the frames that are not missing, the share in which the image has shown a part."""
        there = ~np.isin(np.array(self.numbers), self.missing)
        shares = self.of_parts(self.seen)[there].mean(axis=0) if there.any() else np.zeros(len(PARTS))
        return dict(zip(PARTS, map(float, shares), strict=True))

    @property
    def stationary_periods(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which nothing of the body was seen."""
        return periods(self.numbers, self.stationary)

    @cached_property
    def labels(self) -> HandLabels:
        """Which hand is left, by the whole film; to be asked for when all frames are there."""
        numbers, times = np.array(self.numbers, np.int64), np.array(self.times)
        return hand_labels(numbers, times, np.array(self.exchange_log_odds), np.array(self.confusable))

    @property
    def exchanged(self) -> Array:
        """Probability of each frame that hands have each other's name, after what was relabelled."""
        found = self.labels
        return np.where(found.exchanged, 1 - found.probabilities, found.probabilities)

    @property
    def relabelled(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which hands have changed their names at the end."""
        return periods(self.numbers, self.labels.numbers[self.labels.exchanged].tolist())

    def of_parts(self, columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """Values `(n, 3, ...)` of head and hands by their final names, from those of every frame."""
        values = np.array(columns)
        chosen = self.labels.exchanged
        values[chosen] = values[chosen][:, EXCHANGED_PARTS]
        return values

    @property
    def doubts(self) -> dict[str, list[Doubt]]:
        """When hands may be exchanged, or one of them elsewhere."""
        probabilities = {"exchanged": self.exchanged}
        unsure = self.of_parts(self.unsure)
        probabilities |= {PARTS[hand]: unsure[:, hand] for hand in (1, 2)}
        return {name: doubts(self.numbers, self.times, each) for name, each in probabilities.items()}

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        notes = [*super().notes, *in_words(self.doubts)]
        if self.relabelled:
            notes.append(
                "By the whole film, left and right hand have changed their names in "
                f"{listed_periods(self.relabelled)}."
            )
        if self.stationary:
            notes.append(
                f"Nothing of the body was seen, and it was only predicted, in "
                f"{listed_periods(self.stationary_periods)}."
            )
        for name, share in self.shares_seen.items():
            if share < RARELY_SEEN:
                hidden = "seen" if name == "head" else "seen, or not told from the face,"
                notes.append(
                    f"The {name.replace('_', ' ')} was not {hidden} in {100 * (1 - share):.0f} % of the "
                    "frames: its position there is a guess from its motion and the rest of the body."
                )
        return notes


def write_body_report(path: Path, record: BodyRecord, summary: Mapping[str, Any], title: str) -> None:
    """Write the report of a run as one HTML file.

    Parameters
    ----------
    path
        file to write; it appears when it is complete.
    record
        what was gathered, one frame at least.
    summary
        content of `summary.json`.
    title
        heading of the page.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    note = paragraph(
        "Left: the frame with poses drawn from the posterior (thin), their mean (bold), and ellipses that "
        "hold head and hands with a probability of 90 %; the person's left arm is blue, the right one "
        "orange. Right: the same from the side, the viewer on the left."
    )
    sections: list[Section] = [
        ("Pictures over time", [note, record.snapshots.column()]),
        ("Head and hands", [_places(record), _seen(record)]),
        ("Doubt", [_doubt(record)]),
        ("Tracker", [_tracker(record)]),
        ("Body", [_body(summary["body"])]),
    ]
    write_run_page(path, title, _summary(summary), summary["notes"], sections, summary["parameters"])


def _summary(summary: Mapping[str, Any]) -> Markup:
    shares = {
        f"{name.replace('_', ' ')} seen": f"{100 * share:.0f} %" for name, share in summary["seen"].items()
    }
    values = {
        "frames": f"{summary['frames']}",
        "frames a second": f"{summary['frames_per_second']:.1f}",
        "frames a second, tracker": f"{summary['frames_per_second_of_engine']:.1f}",
        **shares,
        "missing": f"{summary['missing_frames']}",
        "samples": f"{summary['parameters']['samples']}",
    }
    return cards(values)


def _over_time(record: BodyRecord, plots: Sequence[tuple[str, Sequence[Line]]], caption: str) -> Markup:
    """Plots in which periods without any feature are shaded."""
    time_of = dict(zip(record.numbers, record.times, strict=True))
    shaded = [(time_of[first], time_of[last]) for first, last in record.stationary_periods]
    if shaded:
        caption += " Shaded: nothing was seen."
    return over_time(record.times, plots, caption, shaded)


def _places(record: BodyRecord) -> Markup:
    places, spreads = record.of_parts(record.places), HALF_90 * record.of_parts(record.spreads)
    plots = []
    for axis, name in enumerate(("x, px\n(to the right)", "y, px\n(down)", "z, px\n(away)")):
        lines = []
        for part, (label, colour) in enumerate(zip(PARTS, COLOURS, strict=True)):
            mean, half = places[:, part, axis], spreads[:, part, axis]
            lines.append(Line(label.replace("_", " "), colour, mean, (mean - half, mean + half)))
        plots.append((name, lines))
    return _over_time(record, plots, "Posterior means, with bands that hold 90 % of a Gaussian.")


def _seen(record: BodyRecord) -> Markup:
    seen = record.of_parts(record.seen)
    rows = [
        (name.replace("_", " "), int(np.count_nonzero(seen[:, part])), f"{100 * share:.1f} %")
        for part, (name, share) in enumerate(record.shares_seen.items())
    ]
    times, numbers = record.times, np.array(record.numbers)
    time_of = dict(zip(record.numbers, times, strict=True))
    each = float(np.median(np.diff(times))) if len(times) > 1 else 1.0

    def draw(canvas: "Figure") -> None:
        axis = canvas.subplots()
        for part, colour in enumerate(COLOURS):
            there = [
                (time_of[first] - each / 2, time_of[last] - time_of[first] + each)
                for first, last in periods(record.numbers, numbers[seen[:, part]].tolist())
            ]
            axis.broken_barh(there, (-part - 0.3, 0.6), facecolors=colour, linewidth=0)
        axis.set_yticks([0, -1, -2], [name.replace("_", " ") for name in PARTS])
        axis.set_xlim(times[0] - each, times[-1] + each)
        axis.set_xlabel("time in the video, s")

    return Markup(
        table(("part", "frames in which it was seen", "of those that are not missing"), rows)
        + figure(
            draw,
            (11, 1.8),
            "When the image has shown the parts. A hand before face or neck does not count, since their "
            "skin may be all that was seen.",
        )
    )


def _doubt(record: BodyRecord) -> Markup:
    unsure = record.of_parts(record.unsure)
    lines = [
        Line("second answer", RED, np.array(record.second)),
        *(
            Line(f"{PARTS[hand].replace('_', ' ')} elsewhere", COLOURS[hand], unsure[:, hand])
            for hand in (1, 2)
        ),
        Line("hands exchanged", GREEN, record.exchanged),
    ]
    rows = [
        (name.replace("_", " "), each.frames, f"{100 * each.probability:.0f} %")
        for name, stretches in record.doubts.items()
        for each in stretches
    ]
    caption = (
        "Poses drawn from the posterior, gathered by where their hands are: the probability of the second "
        "best answer, of answers with a hand elsewhere than in the best one, and, by the whole film, that "
        "hands have each other's name."
    )
    return Markup(
        _over_time(record, [("probability", lines)], caption)
        + (table(("what may be otherwise", "frames", "probability, at most"), rows) if rows else "")
    )


def _tracker(record: BodyRecord) -> Markup:
    return _over_time(
        record,
        [
            ("log evidence,\nnats", [Line("evidence", BLUE, np.array(record.log_evidence))]),
            ("log₁₀ of samples,\neffective number", [Line("samples", BLUE, np.log10(record.effective))]),
            ("seconds a frame", [Line("seconds", BLUE, np.array(record.seconds))]),
        ],
        "Log of the mean likelihood of a frame under its samples, up to a constant; 1 / Σ weight²; time of "
        "the tracker.",
    )


def _body(body: Mapping[str, Any]) -> Markup:
    rows = [(name.replace("_", " "), value) for name, value in body["lengths"].items()]
    return Markup(paragraph(body["origin"]) + table(("length", "px"), rows))
