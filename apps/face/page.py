"""The page of a face: mesh over the film, head in space with its texture, pose and evidence over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from ...models.face.morphable_model import MorphableModel
from ..view.film import Film, Row
from ..view.page import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    Line,
    Page,
    Plot,
    Section,
    TimelineRow,
    encoded,
    spans_of,
    table,
)
from .record import ANGLES, FaceRecord, angles
from .texture import spread_vertices

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MOST_POINTS = 120
"""Vertices that are shown over the film, and can be selected: all of a coarse model."""

MOST_MORPHS = 10
"""Curves in a plot."""

INK = "#f2c500"
MORPH_INKS = (
    BLUE, ORANGE, GREEN, RED, "#8562b8", "#8a6a4f", "#d06fb0", "#7f7f7f", "#a8a92c", "#2fa6b5",
)  # fmt: skip


class FaceDrawing:
    """What the page shows of a person's own model."""

    def __init__(self, model: MorphableModel) -> None:
        self._model = model
        self._shown = spread_vertices(model.bases[0], MOST_POINTS)
        triangles: NDArray[Any]
        if len(self._shown) == model.n_vertices:
            triangles = np.argsort(self._shown)[model.triangles]
        else:
            triangles = Delaunay(model.bases[0, self._shown, :2]).simplices
        self._mesh = triangles.astype(np.int32)

    def drawn(self, row: Mapping[str, Any], error: float) -> Row:
        """What is drawn of a frame, from its row of `poses.npz`, and the error against landmarks, px."""
        x, y = row["vertices_2d"][self._shown].T
        covariances = row["covariance"][self._shown]
        rotation = row["mean_rotation"]
        points = [x, y, covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]]
        pose = [rotation.ravel(), row["mean_translation"], row["mean_morphs"]]
        numbers = [
            *np.round(angles(rotation), 4),
            error,
        ]
        return {
            "points": np.stack(points, axis=1).astype(np.float32),
            "pose": np.concatenate(pose)[None].astype(np.float32),
            "landmarks": row["landmarks"].astype(np.float32),
            "numbers": np.array(numbers, np.float32)[None],
            "states": np.array([[row["lost"], row["missing"], row["reinitialised"]]]),
        }

    def layer(self, film: Film, textures: Mapping[str, Image], on_texture: Array) -> dict[str, Any]:
        """What is drawn over a film with what `drawn` gives, and beside it.

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
    """Fill the page of a run of one frame at least.

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
    """What is drawn over a film with columns of `FaceDrawing.drawn`, and the row of the face."""
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
        plot("experts, effective", "", [Line(np.array(record.experts))], "1 / Σ weight²."),
    ]
    if film is not None:
        points = film.columns["points"].reshape(len(film.numbers), -1, 5)
        unsure = np.sqrt(points[:, :, [2, 4]].sum(axis=2).mean(axis=1))
        caption = "How the experts differ, root mean square over the points on the film."
        plots.append(plot("points ±", "px", [Line(unsure, x=film.times)], caption))
    if np.isfinite(record.errors).any():
        caption = "Mean distance of the carried landmarks from the given ones."
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
