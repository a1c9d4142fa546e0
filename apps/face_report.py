"""The report of a face-tracking run as one page: pose, evidence, errors over time, texture, pictures."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..models.frame import Frame
from ..models.pose import Poses
from .report import (
    MOST_SNAPSHOTS,
    Html,
    Section,
    cards,
    figure,
    paragraph,
    picture_grid,
    small,
    table,
    write_run_page,
)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

BLUE, ORANGE, GREEN, RED = "#2f7fc1", "#d9822b", "#3a9a5b", "#d64545"
ANGLES = ("turned to the left", "tilted down", "leaned clockwise")
MOST_MORPHS = 10  # curves in a plot


def angles(rotation: Array) -> Array:
    """`(3,)` degrees by which a face that looks at the viewer was turned, as he sees it.

    First about the axis towards the viewer (clockwise), then about the horizontal one (down), at last about
    the vertical one (to the viewer's left), each counted positive.
    """
    turned, tilted, leaned = Rotation.from_matrix(rotation).as_euler("YXZ", degrees=True)
    return np.array([turned, tilted, leaned])


@dataclass(eq=False)
class FaceRecord:
    """What summary and report need of a run, gathered frame by frame: a few numbers each, and some pictures.

    Parameters
    ----------
    numbers, times
        of the frames, 1-based and seconds.
    log_evidence
        nats; NaN in the first frame, and where nothing was to be seen.
    fits
        share of the picture under the face that the texture explained, at most 1; NaN as above.
    errors
        px: mean distance of the landmarks from the given ones; NaN where none is given.
    experts
        effective number of experts, 1 / sum of squared weights.
    seconds
        that the tracker took.
    lost, missing, restarted
        numbers of the frames in which that was so.
    """

    numbers: "array[int]" = field(default_factory=lambda: array("q"))
    times: "array[float]" = field(default_factory=lambda: array("d"))
    log_evidence: "array[float]" = field(default_factory=lambda: array("d"))
    fits: "array[float]" = field(default_factory=lambda: array("d"))
    errors: "array[float]" = field(default_factory=lambda: array("d"))
    experts: "array[float]" = field(default_factory=lambda: array("d"))
    seconds: "array[float]" = field(default_factory=lambda: array("d"))
    angles: list[Array] = field(default_factory=list)
    morphs: list[Array] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)
    restarted: list[int] = field(default_factory=list)
    snapshots: list[tuple[int, float, Image]] = field(default_factory=list)
    stride: int = 1  # frames between snapshots

    def add(
        self,
        frame: Frame,
        mean: Poses,
        weights: Array,
        log_evidence: float,
        fit: float,
        error: float,
        seconds: float,
        *,
        lost: bool,
        restarted: bool,
        overlay: Callable[[], Image],
    ) -> None:
        """Take in a frame; `overlay` is called for the few frames of which a picture is kept."""
        count = len(self.numbers)
        self.numbers.append(frame.number)
        self.times.append(frame.time)
        self.log_evidence.append(log_evidence)
        self.fits.append(fit)
        self.errors.append(error)
        self.experts.append(1 / float(weights @ weights))
        self.seconds.append(seconds)
        self.angles.append(angles(mean.rotations[0]))
        self.morphs.append(mean.morphs[0])
        for numbers, so in ((self.lost, lost), (self.missing, frame.missing), (self.restarted, restarted)):
            if so:
                numbers.append(frame.number)
        if count % self.stride == 0:
            self.snapshots.append((frame.number, frame.time, small(overlay())))
            if len(self.snapshots) > MOST_SNAPSHOTS:
                del self.snapshots[1::2]
                self.stride *= 2

    @property
    def lost_periods(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which the face was lost."""
        was_lost = np.isin(np.array(self.numbers), self.lost)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], was_lost, [False]]).astype(np.int8)))
        return [
            (self.numbers[first], self.numbers[after - 1]) for first, after in edges.reshape(-1, 2).tolist()
        ]

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        notes = []
        if self.missing:
            notes.append(f"Missing, unreadable or blank, and only predicted: {_listed(self.missing)}.")
        if self.lost:
            periods = [f"{a} to {b}" if b > a else str(a) for a, b in self.lost_periods]
            notes.append(f"Lost in {_listed(periods)}.")
        if self.restarted:
            notes.append(f"Found again: {_listed(self.restarted)}.")
        return notes

    @property
    def evidence_measures(self) -> dict[str, Any]:
        """Statistics of the log evidence, nats, over frames in which something was to be seen."""
        values = np.array(self.log_evidence)
        if not np.isfinite(values).any():
            return {}
        return {
            "mean": float(np.nanmean(values)),
            "median": float(np.nanmedian(values)),
            "lowest": float(np.nanmin(values)),
            "lowest_frame": self.numbers[int(np.nanargmin(values))],
        }

    def error_measures(self, size: float) -> dict[str, Any] | None:
        """Distances from given landmarks that are `size` px large; `None` where there are none."""
        values = np.array(self.errors)
        known = np.isfinite(values)
        if not known.any():
            return None
        mean = float(values[known].mean())
        return {
            "frames": int(np.count_nonzero(known)),
            "mean_px": mean,
            "median_px": float(np.median(values[known])),
            "worst_px": float(values[known].max()),
            "worst_frame": self.numbers[int(np.nanargmax(values))],
            "last_px": float(values[known][-1]),
            "size_of_landmarks_px": size,
            "mean_percent_of_size": 100 * mean / size if size else None,
        }


def _listed(numbers: Sequence[object], most: int = 20) -> str:
    """For instance "frames 3, 4, 7"; long lists are cut short."""
    listed = ", ".join(map(str, numbers[:most])) + (", …" if len(numbers) > most else "")
    return f"frame{'s' if len(numbers) > 1 or ' ' in listed else ''} {listed}"


def write_face_report(
    path: Path,
    record: FaceRecord,
    summary: Mapping[str, Any],
    names: Sequence[str],
    textures: Mapping[str, Image],
    title: str,
) -> None:
    """Write the report of a run as one HTML file.

    Parameters
    ----------
    path
        file to write; it appears when it is complete.
    record
        what was gathered, one frame at least.
    summary
        content of `summary.json`.
    names
        of the morph bases.
    textures
        pictures of equal size by their names.
    title
        heading of the page.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    sections: list[Section] = []
    columns = [f"frame {number}, {time:.1f} s" for number, time, _ in record.snapshots]
    note = paragraph(
        "Red: vertices of all experts; light blue: the given landmarks, carried on the surface. "
        "Lower left: axes of the mean pose; lower right: the mean shape from the front and from the side."
    )
    pictures = picture_grid([("overlay", [picture for *_, picture in record.snapshots])], columns)
    sections.append(("Pictures over time", [note, pictures]))
    sections.append(("Pose", [_pose(record)]))
    sections.append(("Evidence", [_evidence(record)]))
    if summary["error"]:
        sections.append(("Against the given landmarks", [_errors(record, summary["error"])]))
    if record.morphs[0].size > 1:
        sections.append(("Expression", [_expression(record, names)]))
    text = paragraph("Of the most credible expert at the end, on the mean shape.")
    sections.append(("Texture", [text, picture_grid([("", list(textures.values()))], list(textures))]))
    write_run_page(path, title, _summary(summary), summary["notes"], sections, summary["parameters"])


def _summary(summary: Mapping[str, Any]) -> Html:
    values = {
        "frames": f"{summary['frames']}",
        "frames a second": f"{summary['frames_per_second']:.1f}",
        "frames a second, tracker": f"{summary['frames_per_second_of_tracker']:.1f}",
        "frames lost": f"{summary['lost_frames']}",
        "re-initialisations": f"{len(summary['reinitialised'])}",
        "missing": f"{summary['missing_frames']}",
        "experts": f"{summary['parameters']['experts']}",
    }
    if summary["error"]:
        values["mean error"] = f"{summary['error']['mean_px']:.2f} px"
    return cards(values)


def _over_time(
    record: FaceRecord, curves: Sequence[tuple[str, Sequence[tuple[str, str, Array]]]], caption: str
) -> Html:
    """Plots below each other, each of lines (label, colour, values a frame); lost periods are shaded."""
    times = np.array(record.times)
    half = 0.5 * float(np.median(np.diff(times))) if len(times) > 1 else 0.5
    time_of = dict(zip(record.numbers, record.times, strict=True))

    def draw(canvas: Figure) -> None:
        axes = canvas.subplots(len(curves), sharex=True, squeeze=False)[:, 0]
        for axis, (name, lines) in zip(axes, curves, strict=True):
            for label, colour, values in lines:
                axis.plot(times, values, color=colour, linewidth=1.2, label=label)
            for first, last in record.lost_periods:
                axis.axvspan(time_of[first] - half, time_of[last] + half, color=RED, alpha=0.18, linewidth=0)
            for number in record.restarted:
                axis.axvline(time_of[number], color=RED, linewidth=0.8, linestyle=":")
            axis.set_ylabel(name)
            axis.margins(x=0.01)
            if len(lines) > 1:
                axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9)
        axes[-1].set_xlabel("time in the video, s")
        canvas.align_ylabels()

    if record.lost:
        caption += " Shaded: lost."
    if record.restarted:
        caption += " Dotted: re-initialised."
    return figure(draw, (11, 1.2 + 1.9 * len(curves)), caption.strip())


def _pose(record: FaceRecord) -> Html:
    turns = np.array(record.angles)
    lines = [
        (name, ink, turns[:, k])
        for k, (name, ink) in enumerate(zip(ANGLES, (BLUE, ORANGE, GREEN), strict=True))
    ]
    size = np.array([morphs[0] for morphs in record.morphs])
    return _over_time(
        record,
        [("angle, degrees", lines), ("size c₁, px", [("size", BLUE, size)])],
        "Of the mean pose; left and clockwise as the viewer sees them.",
    )


def _evidence(record: FaceRecord) -> Html:
    return _over_time(
        record,
        [
            ("log evidence,\nnats", [("evidence", BLUE, np.array(record.log_evidence))]),
            ("share of the\npicture explained", [("fit", BLUE, np.array(record.fits))]),
            ("effective number\nof experts", [("experts", BLUE, np.array(record.experts))]),
        ],
        "Evidence of the effective pixels of a frame under what was predicted for it; share of the variance "
        "under the face that the texture explains, by which it is told to be lost; experts: 1 / Σ weight².",
    )


def _errors(record: FaceRecord, error: Mapping[str, Any]) -> Html:
    rows = [(name.replace("_", " "), value) for name, value in error.items()]
    plot = _over_time(
        record,
        [("error, px", [("error", BLUE, np.array(record.errors))])],
        "Mean distance of the carried landmarks from the given ones.",
    )
    return Html(table(("measure", "value"), rows) + plot)


def _expression(record: FaceRecord, names: Sequence[str]) -> Html:
    morphs = np.array(record.morphs)
    shares = morphs[:, 1:] / morphs[:, :1]
    largest = np.sort(np.argsort(-np.abs(shares).max(axis=0))[:MOST_MORPHS])
    called = [names[k + 1] if k + 1 < len(names) else f"c{k + 2}" for k in range(shares.shape[1])]
    lines = [(called[k], f"C{place}", shares[:, k]) for place, k in enumerate(largest.tolist())]
    left_out = shares.shape[1] - len(largest)
    caption = "Morph coefficients as shares of the size." + (
        f" {left_out} smaller ones left out." if left_out else ""
    )
    return _over_time(record, [("c / c₁", lines)], caption)
