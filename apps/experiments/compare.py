"""Comparison of methods on one film: Fig. 8's table and Fig. 11's pictures of the RSMCM paper."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...inference import RecursiveBP
from ...inference.engine.recursive_bp import RunState
from ...models.core.frame import Frame
from ..background.application import FrameResult, build_model, read_frame_result
from ..background.job import BackgroundJob, Camera, Engine
from ..background.parameters import Parameters, read_parameters
from ..evaluation.scoring import Scoring, scoring_of
from ..io.detections import given_boxes, with_boxes
from ..io.sources.open_source import open_source
from ..io.tracks import TrackedBox
from ..runs.interruption import Interruption, Outcome
from ..runs.progress import Progress
from ..runs.region import inside, read_region
from .baselines import CleanUp, KalmanHungarian, Setting, TrackerParameters, components
from .experiment import TALLEST, Findings, Plot, pictures, publish
from .record import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Image = NDArray[np.uint8]

CHAINS: tuple[tuple[str, Engine], ...] = (("feed-forward", "feed-forward"), ("RSMCM", "recursive-bp"))
"""What is compared through the feedback of one connection and nothing else."""

PRIORS = (0.5, 0.7, 0.9, 0.99)  # P(B) of the stand-alone background, as in Fig. 8
SHOWN_PRIOR = 0.9  # which of them Fig. 11's picture shows
COLUMNS = 5  # of Fig. 11's picture
PICTURE_WIDTH = 240  # px


class Model:
    """Multi-chain model with a name for tables; engine, parameters and camera are as of `build_model`.

    `size` is `(width, height)` px of the pictures, `state` that before the first frame.
    """

    def __init__(
        self,
        name: str,
        engine: Engine,
        size: tuple[int, int],
        parameters: Parameters | None = None,
        camera: Camera = "fixed",
        state: RunState | None = None,
    ) -> None:
        self.name, self.tracks, self._size = name, engine != "stand-alone", size
        self._engine = RecursiveBP(build_model(engine, parameters, camera))
        self._state = RunState() if state is None else state

    def step(self, frame: Frame) -> FrameResult:
        """Process the next frame."""
        belief = self._engine.step(self._state, frame)
        self._state = belief.state
        return read_frame_result(belief, self._size)

    def background(self) -> Image:
        """Return the estimated background, `(height, width[, 3])` uint8."""
        if not self._state.states:
            return np.zeros((self._size[1], self._size[0]), np.uint8)
        picture: Image = self._state.states["background"].picture()
        return picture


class BaselineTracker:
    """Usual pipeline: a subtractor, a clean-up of its mask, Kalman filters and assignment by overlap.

    `size` is `(width, height)` px of the pictures, `parameters` are those of `KalmanHungarian`.
    """

    tracks = True

    def __init__(
        self, name: str, setting: Setting, size: tuple[int, int], parameters: TrackerParameters = (0.1, 5, 20)
    ) -> None:
        self.name, self._subtractor, self._clean_up = name, setting.make(), setting.clean_up
        self._tracker = KalmanHungarian(*parameters)
        self._mask: Image = np.zeros((size[1], size[0]), np.uint8)

    def step(self, frame: Frame) -> FrameResult:
        """Process the next frame; a missing one leaves the mask as it was."""
        if frame.image is not None:
            self._mask = self._clean_up.apply(self._subtractor.apply(frame.image))
        found = self._tracker.update(components(self._mask)[:, :4])
        return FrameResult(self._mask, [TrackedBox(int(i), (x, y, w, h)) for i, x, y, w, h in found.tolist()])


@dataclass
class Tally:
    """Results of one method, frame by frame."""

    method: Model | BaselineTracker
    scoring: Scoring | None
    seconds: float = 0.0
    share: float = 0.0  # of the picture that is foreground, summed over frames
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, frame: Frame, region: Image | None) -> FrameResult:
        """Run the method on a frame, and add its results."""
        started = perf_counter()
        found = self.method.step(frame)
        self.seconds += perf_counter() - started
        if region is not None:
            found = FrameResult(found.foreground & region, inside(region, found.tracks))
        self.share += float(np.count_nonzero(found.foreground)) / found.foreground.size
        if self.scoring is not None:
            self.scoring.add(frame.number, found.foreground)
            self.rows += [(frame.number, track.identity, *track.box) for track in found.tracks]
        return found

    def values(self, n_frames: int) -> dict[str, Any]:
        """Return the method's line of the table."""
        line: dict[str, Any] = {
            "method": self.method.name,
            "foreground, %": 100 * self.share / n_frames,
            "ms a frame": 1e3 * self.seconds / n_frames,
        }
        rows = np.array(self.rows, np.float64).reshape(-1, 6) if self.method.tracks else None
        measured = {} if self.scoring is None else self.scoring.measures(rows)
        errors, pixels, tracks = (measured.get(name, {}) for name in ("errors", "pixels", "tracks"))
        for name, title in ERRORS.items():
            if name in errors:
                line[title] = errors[name]
        line |= {name: pixels[name] for name in ("precision", "recall", "F") if name in pixels}
        line |= {title: tracks[name] for title, name in TRACKS.items() if name in tracks}
        return line


ERRORS = {
    "missed_pedestrians": "missed pedestrians",
    "missed_vehicles": "missed vehicles",
    "missed_objects": "missed objects",
    "ghosts": "ghosts",
    "missed and ghosts": "total",
}
TRACKS = {"IDF1": "idf1", "HOTA": "hota", "MOTA": "mota", "id switches": "switches"}
"""Attributes of `TrackScores` by what they are called in tables."""


@dataclass(frozen=True)
class Moment:
    """A frame in Fig. 11: number, input, and background and foreground of both systems."""

    number: int
    pictures: tuple[Image, ...]


@dataclass
class Gallery:
    """Evenly spaced moments of a source of unknown length: ten at most, of which five are shown."""

    moments: list[Moment] = field(default_factory=list)
    stride: int = 1
    seen: int = 0

    def add(self, number: int, image: Image, systems: Sequence[tuple[Model, FrameResult]]) -> None:
        """Keep a frame and both systems' results, if it is one of those to keep.

        Whenever there are more, every second one goes and the distance doubles.
        """
        if self.seen % self.stride == 0:
            made = [shown for model, found in systems for shown in (model.background(), found.foreground)]
            self.moments.append(Moment(number, tuple(_small(each) for each in (image, *made))))
            if len(self.moments) > 2 * COLUMNS:
                del self.moments[1::2]
                self.stride *= 2
        self.seen += 1

    def chosen(self) -> list[Moment]:
        """Return up to five of them, evenly spaced, with the last."""
        kept = self.moments
        return [kept[round(place)] for place in np.linspace(0, len(kept) - 1, min(COLUMNS, len(kept)))]

    def plot(self) -> Plot:
        """Return Fig. 11: what was chosen, in columns."""
        moments = self.chosen()
        rows = [(name, [each.pictures[k] for each in moments]) for k, name in enumerate(FIGURE_ROWS)]
        caption = "Over time, as in Fig. 11 of the RSMCM paper"
        return pictures("compare-pictures.png", rows, [f"frame {each.number}" for each in moments], caption)


def _small(image: Image) -> Image:
    height, width = image.shape[:2]
    scale = PICTURE_WIDTH / max(width, height / TALLEST)
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


FIGURE_ROWS = (
    "input",
    *(
        f"{name}: {what}"
        for name in (f"stand-alone, P(B) = {SHOWN_PRIOR}", "RSMCM")
        for what in ("background", "foreground")
    ),
)


def methods_of_figure_8(
    size: tuple[int, int], parameters: Parameters, camera: Camera = "fixed"
) -> list[Model | BaselineTracker]:
    """Return the background alone at several P(B), feed-forward, RSMCM, and OpenCV's subtractors.

    The latter know neither parameters nor a camera that moves. `size` is `(width, height)` px.
    """
    background, clean_up = parameters.get("background", {}), CleanUp(median=5, min_area=50)
    alone: list[tuple[str, Engine, Parameters]] = [
        (f"stand-alone, P(B) = {prior}", "stand-alone", {"background": {**background, "prior": prior}})
        for prior in PRIORS
    ]
    return [
        *(Model(name, engine, size, given, camera) for name, engine, given in alone),
        *(Model(name, engine, size, parameters, camera) for name, engine in CHAINS),
        BaselineTracker("MOG2, 5x5 median", Setting("MOG2", 500, 16, clean_up), size),
        BaselineTracker("KNN, 5x5 median", Setting("KNN", 500, 400, clean_up), size),
    ]


def run_compare(job: BackgroundJob) -> Outcome:
    """Run all methods over the job's source; leave table, figures and page in its folder.

    Ctrl-C ends it after the current frame with the comparison until there.

    Raises
    ------
    ValueError, OSError
        in one line, whatever is wrong with the job.
    """
    parameters = read_parameters(job.config, job.chain)
    with (
        Interruption() as interruption,
        open_source(job.source, job.start, job.stop, job.step) as source,
    ):
        if source.live:
            raise ValueError(f"compare: {source.name} is live and cannot be read again")
        region = read_region(job.roi, source.size) if job.roi else None
        tallies = {
            method.name: Tally(method, scoring_of(job.ground_truth, source, job.start, job.step, region))
            for method in methods_of_figure_8(source.size, parameters, job.camera)
        }
        shown = [tallies[name].method for name in (f"stand-alone, P(B) = {SHOWN_PRIOR}", "RSMCM")]
        gallery, n_frames = Gallery(), 0
        given = given_boxes(job.detections, job.class_names, source, job.start, job.stop, job.step)
        frames = interruption.items(source)
        with Progress("comparison", source.n_frames) as progress:
            for frame in frames if given is None else with_boxes(frames, given):
                found = {name: tally.add(frame, region) for name, tally in tallies.items()}
                n_frames += 1
                if frame.image is not None:
                    systems = [(each, found[each.name]) for each in shown if isinstance(each, Model)]
                    gallery.add(frame.number, frame.image, systems)
                progress.update()
    if n_frames:
        lines = [tally.values(n_frames) for tally in tallies.values()]
        header = list(dict.fromkeys(name for line in lines for name in line))
        table = Table(header, [[line.get(name, "–") for name in header] for line in lines])
        plots = [errors_plot(lines)] if "total" in header else []
        findings = Findings(f"{Path(source.name).name}: comparison", [table], [], [*plots, gallery.plot()])
        publish("compare", f"rsmcm reproduce compare {job.source}", job.out, lambda: findings)
    return Outcome({"source": source.name, "frames": n_frames, "stream": source.stream}, interruption.signal)


def errors_plot(lines: Sequence[dict[str, Any]]) -> Plot:
    """Return Fig. 8: stacked bars of the error classes, one for each method."""

    def draw(canvas: "Figure") -> None:
        axes = canvas.subplots()
        left = np.zeros(len(lines))
        names = [line["method"] for line in lines]
        kinds = [name for name in list(ERRORS.values())[:-1] if any(line.get(name) for line in lines)]
        for kind, colour in zip(kinds, ("#2f7fc1", "#e0a030", "#7a9e3d", "#c1453b"), strict=False):
            values = np.array([line.get(kind, 0) for line in lines], np.float64)
            axes.barh(names, values, left=left, color=colour, label=kind)
            left += values
        for place, total in enumerate(left):
            axes.annotate(f" {total:.0f}", (total, place), va="center")
        axes.invert_yaxis()
        axes.margins(x=0.1)
        axes.set_xlabel("errors")
        if kinds:
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=len(kinds))

    return Plot("compare-errors.png", draw, (9, 4), "Errors, as in Fig. 8 of the RSMCM paper")
