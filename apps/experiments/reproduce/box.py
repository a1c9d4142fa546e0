"""Fig. 12 of the RSMCM paper on turning objects: how long tracks of points last, and what shape they give."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...drawing.overlay import PointsOverlay
from ...io.datasets import data_folder
from ...runs.progress import Progress
from ...structure.application import Film, read_film
from ...structure.files import point_colours, write_ply
from ...structure.job import Association, StructureJob
from ...structure.page import drawn_of
from ...structure.reconstruction import MOST_ROUNDS, Reconstruction, reconstruct
from ..expectations import Expectation
from ..experiment import Experiment, Picture
from ..record import Table

SEQUENCES = ("cmu-hotel", "bobot")
METHODS: dict[str, Association] = {"stand-alone": "none", "dual-chain": "dual-chain"}


@dataclass(frozen=True, eq=False)
class Result:
    """What a method makes of a sequence."""

    sequence: str
    method: str
    found: Reconstruction

    @property
    def median_length(self) -> float:
        """Frames in which a point is seen, in the median over the points."""
        return float(np.median(np.count_nonzero(self.found.observed, axis=0)))

    @property
    def cells(self) -> list[object]:
        """A line of the table."""
        found = self.found
        return [
            self.sequence, self.method, len(found.positions), len(found.point_of_track), found.n_points,
            self.median_length, found.reprojection_error, found.geometry,
        ]  # fmt: skip


LINE = ("sequence", "method", "frames", "tracks", "points", "median frames of a point", "error, px", "shape")


def reproduce_box(out: Path) -> Experiment:
    """Fig. 12 on CMU's hotel and on a table top: tracker and shape together, and one after the other.

    Raises
    ------
    OSError
        if a sequence cannot be found, or the folder cannot be written to.
    """
    folders = {name: data_folder(name) for name in SEQUENCES}
    lines: list[list[object]] = []
    expectations: list[Expectation] = []
    pictures: list[Picture] = []
    for name, folder in folders.items():
        film = read_film(StructureJob(str(folder), out=out))
        results = [_result(name, method, film) for method in METHODS]
        alone, dual = results
        lines += [result.cells for result in results]
        expectations += [
            Expectation(
                f"{name}: median length of tracks, over stand-alone",
                dual.median_length / alone.median_length,
                ">=",
                2.0,
            ),
            Expectation(
                f"{name}: reprojection error, over stand-alone",
                dual.found.reprojection_error / alone.found.reprojection_error,
                "<=",
                1.0,
            ),
        ]
        for result in results:
            start, found = f"{name}-{result.method}", result.found
            if found.geometry != "none":
                write_ply(out / f"{start}.ply", found, point_colours(film.frames, found))
            middle = len(film.frames) // 2
            overlay, drawn = PointsOverlay(), None
            for index, frame in enumerate(film.frames[: middle + 1]):
                if frame.image is not None:
                    row = drawn_of(found, index)
                    drawn = overlay(frame.image, row, frame.number, frame.time, missing=False)
            if drawn is not None:
                seen = f"{name}, {result.method}: dots are seen, rings predicted"
                pictures.append(Picture(f"{start}.png", drawn, seen))
    return Experiment("Turning objects", [Table(LINE, lines)], expectations, pictures)


def _result(sequence: str, method: str, film: Film) -> Result:
    with Progress(f"{sequence}, {method}", MOST_ROUNDS, unit="rounds") as progress:
        found = reconstruct(film.frames, "second-order", METHODS[method], None, progress.update)
    return Result(sequence, method, found)
