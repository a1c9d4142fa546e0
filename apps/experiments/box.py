"""Fig. 12 of the RSMCM paper on turning objects: how long tracks of points last, and what shape they give."""

import numpy as np

from ...chains.reconstruction import MOST_ROUNDS, Association, Reconstruction, reconstruct
from ..runs.progress import Progress
from ..structure.application import Film, read_film
from ..structure.job import StructureJob
from ..structure.page import drawn_of
from ..view.overlay import PointsOverlay
from .datasets import data_folder
from .expectations import Expectation
from .experiment import Findings, Picture
from .record import Table

SEQUENCES = ("cmu-hotel", "bobot")
METHODS: dict[str, Association] = {"stand-alone": "none", "dual-chain": "dual-chain"}

LINE = ("sequence", "method", "frames", "tracks", "points", "median frames of a point", "error, px", "shape")


def box() -> Findings:
    """Fig. 12 on CMU's hotel and on a table top: tracker and shape together, and one after the other.

    Raises
    ------
    OSError
        if a sequence cannot be found.
    """
    folders = {name: data_folder(name) for name in SEQUENCES}
    lines: list[list[object]] = []
    expectations: list[Expectation] = []
    pictures: list[Picture] = []
    for name, folder in folders.items():
        film = read_film(StructureJob(str(folder), out=folder))  # nothing is written
        lengths, errors = [], []
        for method, association in METHODS.items():
            with Progress(f"{name}, {method}", MOST_ROUNDS, unit="rounds") as progress:
                found = reconstruct(
                    film.frames, association=association, camera="affine", after_round=progress.update
                )
            lengths.append(float(np.median(np.count_nonzero(found.observed, axis=0))))
            errors.append(found.reprojection_error)
            counts = (len(found.positions), len(found.point_of_track), found.n_points)
            lines.append([name, method, *counts, lengths[-1], errors[-1], found.geometry])
            pictures += _pictures(film, found, f"{name}-{method}")
        times, worse = lengths[1] / lengths[0], errors[1] / errors[0]
        expectations += [
            Expectation(f"{name}: median length of tracks, over stand-alone", times, ">=", 2.0),
            Expectation(f"{name}: reprojection error, over stand-alone", worse, "<=", 1.0),
        ]
    return Findings("Turning objects", [Table(LINE, lines)], expectations, pictures)


def _pictures(film: Film, found: Reconstruction, name: str) -> list[Picture]:
    """The middle frame with its points, and the way that they came."""
    overlay, drawn = PointsOverlay(), None
    for index, frame in enumerate(film.frames[: len(film.frames) // 2 + 1]):
        if frame.image is not None:
            row = drawn_of(found, index)
            drawn = overlay(frame.image, row, frame.number, frame.time, missing=False)
    return [] if drawn is None else [Picture(f"{name}.png", drawn, f"{name}: dots are seen, rings predicted")]
