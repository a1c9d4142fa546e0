"""The report of a face-tracking run as one page: pose, evidence, errors over time, texture, pictures."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...models.core.frame import Frame
from ...models.face.pose import Poses
from ..reports.frame_lists import listed, listed_periods, periods
from ..reports.page import Section, cards, paragraph, picture_grid, table, write_run_page
from ..reports.time_plots import BLUE, GREEN, ORANGE, Line, over_time
from ..runs.frame_record import FrameRecord

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

ANGLES = ("turned to the left", "tilted down", "leaned clockwise")
MOST_MORPHS = 10  # curves in a plot

START_SECONDS, START_FIT = 1.0, 0.9
"""s after the start, and the mean fit in them below which it is called poor. Of 20 starts spread over a film
of a talking face all had more, and errors below 6.2 % of the pupils' distance; one with bent head less."""


def angles(rotation: Array) -> Array:
    """`(3,)` degrees by which a face that looks at the viewer was turned, as he sees it.

    First about the axis towards the viewer (clockwise), then about the horizontal one (down), at last about
    the vertical one (to the viewer's left), each counted positive.
    """
    turned, tilted, leaned = Rotation.from_matrix(rotation).as_euler("YXZ", degrees=True)
    return np.array([turned, tilted, leaned])


@dataclass(eq=False, kw_only=True)
class FaceRecord(FrameRecord):
    """What summary and report need of a run, gathered frame by frame: a few numbers each, and some pictures.

    Parameters
    ----------
    log_evidence
        nats; NaN in the first frame, and where nothing was to be seen.
    fits
        share of the picture under the face that the texture explained, at most 1; NaN as above.
    errors
        px: mean distance of the landmarks from the given ones; NaN where none is given.
    experts
        effective number of experts, 1 / sum of squared weights.
    angles, morphs
        a frame each: `(3,)` degrees, see `angles`, and `(n_bases,)` px.
    lost, restarted
        numbers of the frames in which that was so.
    """

    log_evidence: "array[float]" = field(default_factory=lambda: array("d"))
    fits: "array[float]" = field(default_factory=lambda: array("d"))
    errors: "array[float]" = field(default_factory=lambda: array("d"))
    experts: "array[float]" = field(default_factory=lambda: array("d"))
    angles: list[Array] = field(default_factory=list)
    morphs: list[Array] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    restarted: list[int] = field(default_factory=list)

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
        self.snapshots.add(frame, overlay)

    @property
    def lost_periods(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which the face was lost."""
        return periods(self.numbers, self.lost)

    @property
    def start_fit(self) -> float:
        """Share of the picture that the start's texture explained in the first second; NaN if unknown."""
        fits = np.array(self.fits)[np.array(self.times) <= self.times[0] + START_SECONDS]
        known = fits[np.isfinite(fits)]
        return float(known.mean()) if len(known) else np.nan

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        notes = super().notes
        if self.start_fit < START_FIT - 1e-6:
            notes.append(
                f"The start may be poor: its texture explains {self.start_fit:.3f} of the face in the first "
                f"second, usual is {START_FIT} or more. Start where the face looks at the camera with its "
                "mouth closed (--start), or give --landmarks."
            )
        if self.lost:
            notes.append(f"Lost in {listed_periods(self.lost_periods)}.")
        if self.restarted:
            notes.append(f"Found again: {listed(self.restarted)}.")
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
    note = paragraph(
        "Yellow: vertices of all experts; light blue: the given landmarks, carried on the surface. "
        "Beside the frame the mean: its shape from the front and from the side, and its axes."
    )
    sections.append(("Pictures over time", [note, record.snapshots.row("overlay")]))
    sections.append(("Pose", [_pose(record)]))
    sections.append(("Evidence", [_evidence(record)]))
    if summary["error"]:
        sections.append(("Against the given landmarks", [_errors(record, summary["error"])]))
    if record.morphs[0].size > 1:
        sections.append(("Expression", [_expression(record, names)]))
    text = paragraph("Of the most credible expert at the end, on the mean shape.")
    sections.append(("Texture", [text, picture_grid([("", list(textures.values()))], list(textures))]))
    write_run_page(path, title, _summary(summary), summary["notes"], sections, summary["parameters"])


def _summary(summary: Mapping[str, Any]) -> Markup:
    values = {
        "frames": f"{summary['frames']}",
        "frames a second": f"{summary['frames_per_second']:.1f}",
        "frames a second, tracker": f"{summary['frames_per_second_of_engine']:.1f}",
        "frames lost": f"{summary['lost_frames']}",
        "re-initialisations": f"{len(summary['reinitialised'])}",
        "missing": f"{summary['missing_frames']}",
        "experts": f"{summary['parameters']['experts']}",
    }
    if summary["error"]:
        values["mean error"] = f"{summary['error']['mean_px']:.2f} px"
    return cards(values)


def _over_time(record: FaceRecord, plots: Sequence[tuple[str, Sequence[Line]]], caption: str) -> Markup:
    """Plots in which lost periods are shaded and re-initialisations dotted."""
    time_of = dict(zip(record.numbers, record.times, strict=True))
    lost = [(time_of[first], time_of[last]) for first, last in record.lost_periods]
    restarted = [time_of[number] for number in record.restarted]
    if lost:
        caption += " Shaded: lost."
    if restarted:
        caption += " Dotted: re-initialised."
    return over_time(record.times, plots, caption.strip(), lost, restarted)


def _pose(record: FaceRecord) -> Markup:
    turns = np.array(record.angles)
    lines = [
        Line(name, ink, turns[:, k])
        for k, (name, ink) in enumerate(zip(ANGLES, (BLUE, ORANGE, GREEN), strict=True))
    ]
    size = np.array([morphs[0] for morphs in record.morphs])
    return _over_time(
        record,
        [("angle, degrees", lines), ("size c₁, px", [Line("size", BLUE, size)])],
        "Of the mean pose; left and clockwise as the viewer sees them.",
    )


def _evidence(record: FaceRecord) -> Markup:
    return _over_time(
        record,
        [
            ("log evidence,\nnats", [Line("evidence", BLUE, np.array(record.log_evidence))]),
            ("share of the\npicture explained", [Line("fit", BLUE, np.array(record.fits))]),
            ("effective number\nof experts", [Line("experts", BLUE, np.array(record.experts))]),
        ],
        "Evidence of the effective pixels of a frame under what was predicted for it; share of the variance "
        "under the face that the texture explains, by which it is told to be lost; experts: 1 / Σ weight².",
    )


def _errors(record: FaceRecord, error: Mapping[str, Any]) -> Markup:
    rows = [(name.replace("_", " "), value) for name, value in error.items()]
    plot = _over_time(
        record,
        [("error, px", [Line("error", BLUE, np.array(record.errors))])],
        "Mean distance of the carried landmarks from the given ones.",
    )
    return Markup(table(("measure", "value"), rows) + plot)


def _expression(record: FaceRecord, names: Sequence[str]) -> Markup:
    morphs = np.array(record.morphs)
    shares = morphs[:, 1:] / morphs[:, :1]
    largest = np.sort(np.argsort(-np.abs(shares).max(axis=0))[:MOST_MORPHS])
    called = [names[k + 1] if k + 1 < len(names) else f"c{k + 2}" for k in range(shares.shape[1])]
    lines = [Line(called[k], f"C{place}", shares[:, k]) for place, k in enumerate(largest.tolist())]
    left_out = shares.shape[1] - len(largest)
    caption = "Morph coefficients as shares of the size." + (
        f" {left_out} smaller ones left out." if left_out else ""
    )
    return _over_time(record, [("c / c₁", lines)], caption)
