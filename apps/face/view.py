"""A face's part of `view.html`: mesh over the film, head in space with its texture, how sure they are."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from ...models.face.morphable_model import MorphableModel
from ..reports.page import encoded
from ..view.film import Film, Row
from ..view.page import Plot, TimelineRow, View, spans_of
from .overlay import spread_vertices
from .report import ANGLES, angles

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MOST_POINTS = 120
"""Vertices that are shown over the film, and can be selected: all of a coarse model."""

INK = "#f2c500"


class FaceDrawing:
    """What the page shows of a model.

    Parameters
    ----------
    model
        the person's own.
    """

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
        rotation, weights = row["mean_rotation"], row["weights"]
        points = [x, y, covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]]
        pose = [rotation.ravel(), row["mean_translation"], row["mean_morphs"]]
        numbers = [
            *np.round(angles(rotation), 4),
            row["log_evidence"],
            row["fit"],
            1 / (weights @ weights),
            error,
        ]
        return {
            "points": np.stack(points, axis=1).astype(np.float32),
            "pose": np.concatenate(pose)[None].astype(np.float32),
            "landmarks": row["landmarks"].astype(np.float32),
            "numbers": np.array(numbers, np.float32)[None],
            "states": np.array([[row["lost"], row["missing"], row["reinitialised"]]]),
        }

    def view(self, film: Film, textures: Mapping[str, Image], on_texture: Array) -> View:
        """The page of a film with what `drawn` gives.

        Parameters
        ----------
        film
            with columns of `drawn`.
        textures
            pictures of the texture by their captions, and
        on_texture
            `(n_vertices, 2)` px: where on them the vertices are.
        """
        columns, model = film.columns, self._model
        numbers, states = columns["numbers"], columns["states"]
        layer = {
            **{name: columns[name] for name in ("points", "pose", "landmarks", "states")},
            "angles": numbers[:, :3],
            "angleNames": ANGLES,
            "errors": numbers[:, 6],
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
        seen: NDArray[np.bool_] = ~(states[:, 0] | states[:, 1])
        rows = [TimelineRow(0, "face", INK, spans_of(seen))]
        variances = columns["points"].reshape(len(numbers), -1, 5)[:, :, [2, 4]].sum(axis=2)
        unsure = Plot("points ±", "px", np.sqrt(variances.mean(axis=1)))
        return View({"face": layer}, rows, [*_plots(numbers), unsure])


def _plots(numbers: NDArray[np.float32]) -> Sequence[Plot]:
    named = [
        *((name, "°") for name in ANGLES),
        ("log evidence", "nats"),
        ("explained", "%"),
        ("experts, effective", ""),
        ("error", "px"),
    ]
    scale = np.array([1, 1, 1, 1, 100, 1, 1])
    plots = [
        Plot(name, unit, column) for (name, unit), column in zip(named, (scale * numbers).T, strict=True)
    ]
    return [plot for plot in plots if np.isfinite(plot.values).any()]
