"""G-flow on a real film: a generic face model, and a person's own model learned from the film's landmarks."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...chains.face.gflow import GFlow
from ...chains.face.start import FaceStart, start_from_landmarks
from ...inference import MultiChain, RecursiveBP
from ...inference.sfm.nonrigid.learning import learn_shape
from ...models.core.frame import Frame
from ...models.core.pictures import grey_of
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
WINDOW = 9
"""px, side of the window of Lucas and Kanade's tracker; with three levels."""

Method = Callable[[Iterable[Frame], Progress], tuple[Numbers, int]]


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
    methods: list[tuple[str, Method, int]] = [
        ("Surrey model, 20 experts", partial(follow, GFlow(generic.model, generic.pose), generic), 0),
        (
            "Surrey model, 1 expert, dense flow",
            partial(follow, GFlow.optic_flow(generic.model, generic.pose, surface="dense"), generic),
            0,
        ),
        (
            "Surrey model, 1 expert, template",
            partial(follow, GFlow.template(generic.model, generic.pose), generic),
            0,
        ),
        ("points one by one (PyrLK)", partial(points_one_by_one, truth[0]), 0),
        (f"own model, {OWN_BASES} bases, 20 experts", partial(follow, GFlow(own.model, own.pose), own), half),
        (
            f"own model, {OWN_BASES} bases, 1 expert, dense flow",
            partial(follow, GFlow.optic_flow(own.model, own.pose, surface="dense"), own),
            half,
        ),
    ]
    outcomes = []
    with Progress("talking face", sum(len(truth) - first for _, _, first in methods)) as progress:
        for name, method, first in methods:
            with open_source(str(folder / "franck.webm"), start=first + 1, stop=len(truth)) as source:
                places, lost = method(source, progress)
            errors = 100 / unit * np.linalg.norm(places - truth[first:], axis=2).mean(axis=1)
            outcomes.append(Followed(name, first, errors, lost))
    generic_errors = outcomes[0].errors
    expectations = [
        Expectation(
            "(a) Surrey model: mean, % of the pupils' distance", float(generic_errors.mean()), "<=", 7.0
        ),
        Expectation("(a) worst frame, %", float(generic_errors.max()), "<=", 15.0),
        Expectation("(a) frames lost", outcomes[0].lost, "<=", 0),
        Expectation("(b) own model, unseen half: mean error, %", float(outcomes[4].errors.mean()), "<=", 5.0),
    ]
    header = ("method", "frames", "mean, %", "median, %", "95 %, %", "worst, %", "lost")
    lines = [each.row for each in outcomes]
    return Findings(
        "A talking face",
        [Table(header, lines, EXPLANATION)],
        expectations,
        pictures=[Plot("errors.png", lambda canvas: draw(canvas, outcomes), (12.0, 5.0), EXPLANATION)],
    )


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


def points_one_by_one(first: Numbers, frames: Iterable[Frame], progress: Progress) -> tuple[Numbers, int]:
    """Every landmark followed by itself from picture to picture."""
    places, before = [first], None
    now: Any = first.astype(np.float32)[:, None]
    for frame in frames:
        assert frame.image is not None
        image = grey_of(frame.image)
        if before is not None:
            now, _, _ = cv2.calcOpticalFlowPyrLK(
                before, image, now, now.copy(), winSize=(WINDOW, WINDOW), maxLevel=2
            )
            places.append(now[:, 0].astype(np.float64))
        before = image
        progress.update()
    return np.stack(places), 0


def draw(canvas: Figure, outcomes: Sequence[Followed]) -> None:
    """Errors over frames."""
    axes = canvas.add_subplot()
    for each in outcomes:
        axes.plot(each.first + np.arange(len(each.errors)), each.errors, lw=0.8, label=each.name)
    axes.set(xlabel="frame", ylabel="error, % of the pupils' distance", ylim=(0, 35))
    axes.legend(fontsize=8)
