"""The page of a face: mesh over the film, head in space with its texture, pose and evidence over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from ...models.face.morphable_model import MorphableModel
from ..io.row_log import RowLog
from ..view.film import Film, Row
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
    encoded,
    listed,
    listed_periods,
    notes_on_missing,
    periods,
    spans_of,
    table,
)
from .texture import distant_vertices

Numbers = NDArray[np.float64]
Image = NDArray[np.uint8]
ANGLES = ("turned to the left", "tilted down", "leaned clockwise")
START_SECONDS, START_FIT = 1.0, 0.9
"""s after the start, and the mean fit in them below which it is called poor. Of 20 starts spread over a film
of a talking face all had more, and errors below 6.2 % of the pupils' distance; one with bent head less."""


def angles(rotation: Numbers) -> Numbers:
    """Return the turn of the head `(3,)` in degrees, as a viewer whom it faces sees it.

    First about the axis towards the viewer (clockwise), then about the horizontal one (down), at last about
    the vertical one (to the viewer's left), each counted positive.
    """
    turned, tilted, leaned = Rotation.from_matrix(rotation).as_euler("YXZ", degrees=True)
    return np.array([turned, tilted, leaned])


class FaceRecord(FrameRecord):
    """Figures a frame that summary and page need.

    Attributes
    ----------
    lost, restarted
        numbers of the frames in which that was so.
    log_evidence
        nats; NaN in the first frame, and where nothing was to be seen.
    fits
        share of the picture under the face that the texture explained, at most 1; NaN as above.
    probability
        that the face is where it is stated to be; 0 while it is lost.
    errors
        px: mean distance of the landmarks from the given ones; NaN where none is given.
    experts
        effective number of experts, 1 / sum of squared weights.
    angles, morphs
        `(n_frames, 3)` degrees, see `angles`, and `(n_frames, n_bases)` px, of the mean.
    """

    def __init__(self, log: RowLog) -> None:
        super().__init__(log)
        self.lost, self.restarted = (log["number"][log[name]].tolist() for name in ("lost", "reinitialised"))
        self.log_evidence, self.fits, self.errors = log["log_evidence"], log["fit"], log["error"]
        self.probability = np.asarray(log["tracked_probability"])
        self.experts = 1 / np.square(log["weights"]).sum(axis=1)
        self.angles, self.morphs = np.array([*map(angles, log["mean_rotation"])]), log["mean_morphs"]

    @property
    def lost_periods(self) -> list[tuple[int, int]]:
        """First and last frame of every period in which the face was lost."""
        return periods(self.numbers, self.lost)

    @property
    def tracked_probability(self) -> float | None:
        """Mean probability, of the frames in which the face is not lost, that it is where it is stated to be.

        `None` without such a frame.
        """
        tracked = ~np.isin(self.numbers, self.lost)
        return float(self.probability[tracked].mean()) if tracked.any() else None

    @property
    def start_fit(self) -> float:
        """Share of the picture that the start's texture explained in the first second; NaN if unknown."""
        fits = np.array(self.fits)[np.array(self.times) <= self.times[0] + START_SECONDS]
        known = fits[np.isfinite(fits)]
        return float(known.mean()) if len(known) else np.nan

    @property
    def notes(self) -> list[str]:
        """What is out of the ordinary, a sentence each."""
        notes = notes_on_missing(self.missing)
        if self.start_fit < START_FIT - 1e-6:
            notes.append(
                f"The start may be poor: its texture explains {self.start_fit:.3f} of the face in the first "
                f"second, typical is {START_FIT} or more. Start where the face looks at the camera with its "
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
        """Return statistics of distances from given landmarks of `size` px; `None` without any."""
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


MOST_POINTS = 120
"""Vertices that are shown over the film, and can be selected: all of a coarse model."""

MOST_MORPHS = 10
"""Curves in a plot."""

INK = "#f2c500"
MORPH_INKS = (
    BLUE, ORANGE, GREEN, RED, "#8562b8", "#8a6a4f", "#d06fb0", "#7f7f7f", "#a8a92c", "#2fa6b5",
)  # fmt: skip


class FaceDrawing:
    """Drawing of a person's model on the page."""

    def __init__(self, model: MorphableModel) -> None:
        self._model = model
        self._shown = distant_vertices(model.bases[0], MOST_POINTS)
        triangles: NDArray[Any]
        if len(self._shown) == model.n_vertices:
            triangles = np.argsort(self._shown)[model.triangles]
        else:
            triangles = Delaunay(model.bases[0, self._shown, :2]).simplices
        self._mesh = triangles.astype(np.int32)

    def view_row(self, row: Mapping[str, Any], error: float) -> Row:
        """Return what is drawn of a frame: its row of `poses.npz`, and the error against landmarks, px."""
        x, y = row["vertices_2d"][self._shown].T
        covariances = row["covariance"][self._shown]
        rotation = row["mean_rotation"]
        points = [x, y, covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]]
        pose = [rotation.ravel(), row["mean_translation"], row["mean_morphs"]]
        numbers = [*np.round(angles(rotation), 4), error]
        return {
            "points": np.stack(points, axis=1).astype(np.float32),
            "pose": np.concatenate(pose)[None].astype(np.float32),
            "landmarks": row["landmarks"].astype(np.float32),
            "numbers": np.array(numbers, np.float32)[None],
            "states": np.array([[row["lost"], row["missing"], row["reinitialised"]]]),
        }

    def layer(self, film: Film, textures: Mapping[str, Image], on_texture: Numbers) -> dict[str, Any]:
        """Return the page's layer of a film with rows of `view_row`.

        `textures` are pictures by their captions; `on_texture` `(n_vertices, 2)` px says where on them
        vertices are.
        """
        columns, model = film.columns, self._model
        numbers = columns["numbers"]
        return {
            **{name: columns[name] for name in ("points", "pose", "landmarks", "states")},
            "angles": numbers[:, :3],
            "angleNames": ANGLES,
            "errors": numbers[:, 3],
            "shown": self._shown.astype(np.int32),
            "mesh": self._mesh,
            "bases": model.bases.astype(np.float32),
            "triangles": model.triangles.astype(np.int32),
            "onTexture": on_texture.astype(np.float32),
            "textures": [
                {"caption": caption, "png": encoded(picture, ".png")} for caption, picture in textures.items()
            ],
            "ink": INK,
        }


def face_page(
    title: str,
    record: FaceRecord,
    summary: Mapping[str, Any],
    film: Film | None,
    layer: Mapping[str, Any],
    names: Sequence[str],
) -> Page:
    """Return the page of a run of one frame or more.

    The film has columns of `FaceDrawing.drawn`, `layer` is what is drawn over it; `names` are those of the
    morph bases.
    """
    sections: list[Section] = []
    if error := summary["error"]:
        rows = [(name.replace("_", " "), value) for name, value in error.items()]
        sections.append(("Against the given landmarks", [table(("measure", "value"), rows)]))
    layers, timeline = ({}, []) if film is None else over_the_film(film, layer)
    return record.page(
        title,
        summary,
        film,
        cards=_cards(summary),
        layers=layers,
        timeline=timeline,
        plots=_plots(record, names, film),
        sections=sections,
    )


def over_the_film(film: Film, layer: Mapping[str, Any]) -> tuple[dict[str, Any], list[TimelineRow]]:
    """Return the layer over the film, from columns of `FaceDrawing.view_row`, and the face's row."""
    lost, missing, _ = film.columns["states"].T
    return {"face": layer}, [TimelineRow(0, "face", INK, spans_of(np.asarray(~(lost | missing))))]


def _cards(summary: Mapping[str, Any]) -> dict[str, str]:
    cards = {
        "frames": f"{summary['frames']}",
        "frames a second": f"{summary['frames_per_second']:.1f}",
        "frames a second, tracker": f"{summary['frames_per_second_of_engine']:.1f}",
        "frames lost": f"{summary['lost_frames']}",
        "re-initialisations": f"{len(summary['reinitialised'])}",
        "missing": f"{summary['missing_frames']}",
        "experts": f"{summary['parameters']['experts']}",
    }
    if summary["error"]:
        cards["mean error"] = f"{summary['error']['mean_px']:.2f} px"
    return cards


def _plots(record: FaceRecord, names: Sequence[str], film: Film | None) -> list[Plot]:
    """Curves in which lost periods are shaded and re-initialisations dotted."""
    lost = record.spans(record.lost_periods)
    restarted = [first for first, _ in record.spans(zip(record.restarted, record.restarted, strict=True))]
    marks = " Shaded: lost." * bool(lost) + " Dotted: re-initialised." * bool(restarted)

    def plot(name: str, unit: str, lines: Sequence[Line], caption: str = "") -> Plot:
        return Plot(name, unit, lines, (caption + marks).strip(), shaded=lost, dotted=restarted)

    turns, morphs = np.array(record.angles), np.array(record.morphs)
    plots = [
        plot(
            "pose",
            "degrees",
            [Line(turns[:, k], name, (BLUE, ORANGE, GREEN)[k]) for k, name in enumerate(ANGLES)],
            "Of the mean pose; left and clockwise as the viewer sees them.",
        ),
        plot("size c₁", "px", [Line(morphs[:, 0])]),
        plot(
            "log evidence",
            "nats",
            [Line(np.array(record.log_evidence))],
            "Of the effective pixels of a frame under what was predicted for it.",
        ),
        plot(
            "picture explained",
            "%",
            [Line(100 * np.array(record.fits))],
            "Share of the variance under the face that the texture explains, by which it is told to be lost.",
        ),
        plot(
            "tracked",
            "%",
            [Line(100 * record.probability)],
            "Probability that the face is where it is stated to be; 0 while it is lost.",
        ),
        plot("experts, effective", "", [Line(np.array(record.experts))], "1 / Σ weight²."),
    ]
    if film is not None:
        points = film.columns["points"].reshape(len(film.numbers), -1, 5)
        unsure = np.sqrt(points[:, :, [2, 4]].sum(axis=2).mean(axis=1))
        caption = "Root mean square difference between the experts, over the points on the video."
        plots.append(plot("points ±", "px", [Line(unsure, x=film.times)], caption))
    if np.isfinite(record.errors).any():
        caption = "Mean distance of the tracked landmarks from the given ones."
        plots.append(plot("error", "px", [Line(np.array(record.errors))], caption))
    if morphs.shape[1] > 1:
        shares = morphs[:, 1:] / morphs[:, :1]
        largest = np.sort(np.argsort(-np.abs(shares).max(axis=0))[:MOST_MORPHS]).tolist()
        called = [names[k + 1] if k + 1 < len(names) else f"c{k + 2}" for k in range(shares.shape[1])]
        lines = [Line(shares[:, k], called[k], ink) for k, ink in zip(largest, MORPH_INKS, strict=False)]
        left_out = shares.shape[1] - len(largest)
        caption = "Morph coefficients as shares of the size."
        caption += f" {left_out} smaller ones left out." if left_out else ""
        plots.append(plot("expression", "c / c₁", lines, caption))
    return plots
