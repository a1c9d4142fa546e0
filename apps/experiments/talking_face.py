"""G-flow on a real film: a generic face model, and a person's own model learned from the film's landmarks."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow
from ...chains.face.start import FaceStart, start_from_landmarks
from ...inference import MultiChain, RecursiveBP
from ...inference.sfm.nonrigid.learning import learn_shape
from ...models.core.frame import Frame
from ...models.face.model_files import read_correspondences, read_model
from ...models.pixels.pixel_labels import PixelLabels
from ..io.sources.open_source import open_source
from ..runs.progress import Progress
from .datasets import data_folder
from .expectations import Expectation
from .experiment import Findings, Plot
from .record import Table

Numbers = NDArray[np.float64]

PUPILS = (31, 36)
"""Landmarks between which the distance in the first frame is the unit of errors."""
OWN_BASES = 6


@dataclass(frozen=True, eq=False)
class Followed:
    """What a method made of the landmarks.

    Parameters
    ----------
    name
        of the method.
    first
        index of the frame that it started from.
    errors
        `(n_frames,)` mean distance of the landmarks from the true ones, % of the pupils' distance.
    lost
        frames in which the tracker said that it was lost.
    """

    name: str
    first: int
    errors: Numbers
    lost: int

    @property
    def row(self) -> list[object]:
        """Of the table."""
        errors = self.errors
        return [
            self.name, len(errors), float(errors.mean()), *np.percentile(errors, (50, 95)).tolist(),
            float(errors.max()), self.lost,
        ]  # fmt: skip


def talking_face() -> Findings:
    """Track the talking face and measure all 68 landmarks in every annotated frame.

    Raises
    ------
    OSError
        if the film or the model cannot be found.
    """
    folder, surrey = data_folder("talking-face"), data_folder("surrey-face")
    truth = landmarks_of_film(np.load(folder / "landmarks_0000-1999.npy"))
    unit = float(np.linalg.norm(truth[0, PUPILS[0]] - truth[0, PUPILS[1]]))
    half = len(truth) // 2
    pairs = read_correspondences(folder / "fgnet_to_ibug.txt")
    generic = start_from_landmarks(read_model(surrey), truth[0], pairs)
    own = start_from_landmarks(learn_shape(truth[:half], OWN_BASES).model(), truth[half])
    methods = [
        ("Surrey model, 20 experts", generic, 0),
        (f"own model, {OWN_BASES} bases, 20 experts", own, half),
    ]
    outcomes = []
    with Progress("talking face", sum(len(truth) - first for _, _, first in methods)) as progress:
        for name, start, first in methods:
            with open_source(str(folder / "franck.webm"), start=first + 1, stop=len(truth)) as source:
                places, lost = follow(GFlow(start.model, start.pose), start, source, progress)
            errors = 100 / unit * np.linalg.norm(places - truth[first:], axis=2).mean(axis=1)
            outcomes.append(Followed(name, first, errors, lost))
    errors, of_own = outcomes[0].errors, float(outcomes[1].errors.mean())
    mean = "(a) Surrey model: mean, % of the pupils' distance"
    expectations = [
        Expectation(mean, float(errors.mean()), "<=", 7.0),
        Expectation("(a) worst frame, %", float(errors.max()), "<=", 15.0),
        Expectation("(a) frames lost", outcomes[0].lost, "<=", 0),
        Expectation("(b) own model, unseen half: mean error, %", of_own, "<=", 5.0),
    ]
    header = ("method", "frames", "mean, %", "median, %", "95 %, %", "worst, %", "lost")
    plot = Plot("errors.png", lambda canvas: draw(canvas, outcomes), (12.0, 5.0), EXPLANATION)
    lines = [each.row for each in outcomes]
    return Findings("A talking face", [Table(header, lines, EXPLANATION)], expectations, [plot])


EXPLANATION = (
    "Mean distance of the 68 landmarks from the annotated ones, in % of the distance between the pupils in "
    "the first frame. All are attached to the surface where a method starts, and carried by its mean pose."
)


def landmarks_of_film(original: NDArray[np.floating]) -> Numbers:
    """The annotation, made on the original film of 720x576 px, in px of the public one of half its size."""
    places = np.asarray(original, np.float64)
    return np.stack([(places[..., 0] + 7.45) / 2, (places[..., 1] - 0.45) / 2], axis=-1)


def follow(
    chain: GFlow, start: FaceStart, frames: Iterable[Frame], progress: Progress
) -> tuple[Numbers, int]:
    """Landmarks `(n_frames, n_landmarks, 2)` px that the chain carries, and frames in which it was lost."""
    places, lost = [], 0
    for belief in RecursiveBP(MultiChain().connect(chain, PixelLabels())).run(frames):
        state = belief[chain.name]
        places.append(chain.points(state, start.points))
        lost += state.lost
        progress.update()
    return np.stack(places), lost


def draw(canvas: Figure, outcomes: Sequence[Followed]) -> None:
    """Errors over frames."""
    axes = canvas.add_subplot()
    for each in outcomes:
        axes.plot(each.first + np.arange(len(each.errors)), each.errors, lw=0.8, label=each.name)
    axes.set(xlabel="frame", ylabel="error, % of the pupils' distance", ylim=(0, 35))
    axes.legend(fontsize=8)
