"""Deformable shapes learned from tracks: a shark, people and a face, against their true 3-D."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...inference.sfm.nonrigid.learning import LEAST_FRAMES, learn_shape
from ...inference.sfm.nonrigid.shape import NonrigidShape, shape_error
from ..io.point_files import read_shapes
from .datasets import data_folder
from .experiment import Findings, Plot, by_seed
from .record import Expectation, Table, over_seeds

Numbers = NDArray[np.float64]

BASES = {"jaws": 3, "walking": 5, "face": 5, "drink": 5, "dance": 5}
"""By sequence; jaws has as many and no more, it is made of a mean shape and two modes."""
MOTION_CAPTURE = ("drink", "dance")  # before a camera that goes round; the others are from `nrsfm-torresani`
PUBLISHED = {"jaws": 0.05, "walking": 0.23, "face": 0.04, "drink": 0.03, "dance": 0.27}
"""Of the first three about what EM for probabilistic PCA of shape is reported to reach on all points.

Of motion capture the e3D of point trajectories (drink) and of column space fitting (dance), with as many
bases or more.
"""

LINE = (
    "sequence", "bases", "missing", "3-D error", "e3D", "after turning", "reprojection", "iterations",
)  # fmt: skip
MISSING = (0.0, 0.2, 0.5)
SEEDS = range(5)  # of the positions that are withheld

SHOWN = 4  # frames in the pictures


@dataclass(frozen=True, eq=False)
class LearnedShape:
    """Learned shape, and the truth."""

    # name, missing: of the sequence, and the share of its positions that were withheld
    name: str
    missing: float
    learned: NonrigidShape  # the shape
    truth: Numbers  # `(n_frames, n_points, 3)`

    @property
    def label(self) -> str:
        """The sequence and what is missing, in words."""
        return f"{self.name}, {self.missing:.0%} missing"

    @cached_property
    def placed(self) -> Numbers:
        """`(n_frames, n_points, 3)`: shapes about their centroids, in the mirror image that is nearer."""
        return nearer_image(self.learned.shapes(), self.truth)

    @cached_property
    def error(self) -> float:
        """Normalised 3-D error, one mirror image for the whole sequence."""
        return normalised_error(self.placed, self.truth)

    @cached_property
    def e3d(self) -> float:
        """`inference.sfm.nonrigid.shape.shape_error`."""
        return shape_error(self.learned.shapes(), self.truth)

    @property
    def error_after_turning(self) -> float:
        """The same, with each frame's shape turned (or mirrored in depth and turned) onto the truth."""
        return normalised_error(turned_onto(self.placed, self.truth), self.truth)

    @property
    def published(self) -> float:
        """Error by the measure that is published of this sequence."""
        return self.e3d if self.name in MOTION_CAPTURE else self.error

    @property
    def cells(self) -> tuple[float, ...]:
        """The cells of `LINE` that are means over seeds."""
        learned = self.learned
        errors = self.error, self.e3d, self.error_after_turning
        return *errors, learned.relative_error, float(len(learned.history))


ByCase = Mapping[tuple[str, float], Mapping[str, Sequence[LearnedShape]]]


def shapes() -> Findings:
    """Learn the shapes of five sequences, of three also from partial tracks, and measure their 3-D errors.

    Raises
    ------
    OSError
        if the sequences cannot be found.
    """
    truths = {name: read_shapes(sequence_file(name)) for name in BASES}
    learn = partial(learn_withheld, truths, BASES)
    # nothing is random where nothing is withheld
    measured = by_seed("whole tracks", learn, [(name, MISSING[0]) for name in BASES], SEEDS[:1])
    parts = [(name, share) for name in BASES if name not in MOTION_CAPTURE for share in MISSING[1:]]
    measured |= by_seed("partial tracks", learn, parts, SEEDS)
    results = [methods[""][0] for methods in measured.values()]
    lines = [
        [name, BASES[name], f"{missing:.0%}", *np.mean([each.cells for each in methods[""]], axis=0).tolist()]
        for (name, missing), methods in measured.items()
    ]
    table = Table(LINE, lines, EXPLANATION)
    sides = "from the camera and from above; circles: truth"
    pictures = [
        Plot(
            f"{each.name}-{100 * each.missing:.0f}.png",
            partial(draw, each),
            (12.0, 5.5),
            f"{each.label}: {sides}",
        )
        for each in results
        if each.missing in (MISSING[0], MISSING[-1])
    ]
    return Findings("Deformable shapes", [table], over_seeds(expectations_of, measured), pictures)


def learn_withheld(
    truths: Mapping[str, Numbers], bases: Mapping[str, int], case: tuple[str, float], seed: int
) -> dict[str, LearnedShape]:
    """Learn the shape of a sequence of which a share of the positions is withheld."""
    name, missing = case
    tracks = withheld(truths[name][..., :2], missing, np.random.default_rng(seed))
    return {"": LearnedShape(name, missing, learn_shape(tracks, bases[name]), truths[name])}


def expectations_of(measured: ByCase) -> list[Expectation]:
    """Return the error of each sequence, beside what is published."""
    return [
        Expectation(
            f"{shapes[0].label}: {'e3D' if name in MOTION_CAPTURE else '3-D error'}",
            float(np.mean([each.published for each in shapes])),
            "<=",
            PUBLISHED[name],
        )
        for (name, _), methods in measured.items()
        for shapes in methods.values()
    ]


EXPLANATION = (
    "3-D error: mean over frames of |S - T| / |T| (Frobenius norms of shapes about their centroids, in the "
    "camera's axes and the tracks' unit, one mirror image in depth for the whole sequence). e3D: mean "
    "distance of points over the mean standard deviation of the true ones' coordinates, as Gotardo and "
    "Martinez (2011) have it, aligned in the same way. After turning: each frame's shape turned onto the "
    "truth first. Points that were withheld count. Means over the seeds of what is withheld."
)


def sequence_file(name: str) -> Path:
    """Return the path of a sequence.

    Raises
    ------
    OSError
        if it cannot be found.
    """
    return data_folder("nrsfm-mocap" if name in MOTION_CAPTURE else "nrsfm-torresani") / f"{name}.mat"


def withheld(tracks: Numbers, share: float, random: np.random.Generator) -> Numbers:
    """Return tracks `(n_frames, n_points, 2)` with a share of positions replaced by NaN, at random."""
    partial = tracks.copy()
    hidden = random.random(tracks.shape[:2]) < share
    hidden[:LEAST_FRAMES] = False  # every point is to be seen often enough
    partial[hidden] = np.nan
    return partial


def centred(shapes: Numbers) -> Numbers:
    """Return shapes `(n_frames, n_points, 3)` about their centroids."""
    about: Numbers = shapes - shapes.mean(axis=1, keepdims=True)
    return about


def normalised_error(shapes: Numbers, truth: Numbers) -> float:
    """Return the mean over frames of |S - T| / |T|, Frobenius norms about the centroids."""
    away = np.linalg.norm(centred(shapes) - centred(truth), axis=(1, 2))
    return float(np.mean(away / np.linalg.norm(centred(truth), axis=(1, 2))))


def nearer_image(shapes: Numbers, truth: Numbers) -> Numbers:
    """Return the shapes about their centroids or their mirror images in depth, all frames alike."""
    images = [centred(shapes), centred(shapes) * [1, 1, -1]]
    return min(images, key=lambda image: normalised_error(image, truth))


def turned_onto(shapes: Numbers, truth: Numbers) -> Numbers:
    """Turn each shape, or its mirror image in depth, onto the truth by least squares (Procrustes)."""
    goal = centred(truth)
    placed = []
    for image in (centred(shapes), centred(shapes) * [1, 1, -1]):
        left, _, right = np.linalg.svd(np.einsum("njb,nja->nab", image, goal))
        left[..., 2] *= np.linalg.det(left @ right)[:, None]
        placed.append(image @ (left @ right).transpose(0, 2, 1))
    distances = [np.linalg.norm(image - goal, axis=(1, 2)) for image in placed]
    nearer: Numbers = np.where((distances[0] <= distances[1])[:, None, None], *placed)
    return nearer


def draw(result: LearnedShape, canvas: Figure) -> None:
    """Draw some frames' shapes over the truth, from the camera and from above."""
    placed, truth = result.placed, centred(result.truth)
    frames: Sequence[int] = np.linspace(0, len(truth) - 1, SHOWN).astype(int).tolist()
    for column, frame in zip(canvas.subplots(2, SHOWN).T, frames, strict=True):
        for axis, height in zip(column, (1, 2), strict=True):
            axis.scatter(
                truth[frame, :, 0], truth[frame, :, height], s=18, facecolors="none", edgecolors="C0"
            )
            axis.scatter(placed[frame, :, 0], placed[frame, :, height], s=5, color="C3", linewidths=0)
            axis.set_aspect("equal")
            axis.tick_params(labelsize=7)
        column[0].invert_yaxis()
        column[0].set_title(f"frame {frame + 1}", fontsize=10)
