"""The background application: from a source of frames to masks, tracks, pictures and a page."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...chains.objects.object_trajectories import ObjectsOverTime
from ...inference import Belief, MultiChain, RecursiveBP
from ...inference.engine.recursive_bp import RunState
from ...models import Frame, ObjectBoxes, PixelLabels, PixelMessage, ScenePixels
from ...models.camera.moving_camera import UNKNOWNS
from ...models.core.checks import checked
from ...models.files import write_text
from ..evaluation.predictions import FILE, write_predictions
from ..evaluation.scoring import SAVED as SCORES
from ..evaluation.scoring import Scoring, scoring_of
from ..events.page import ZoneEvents
from ..events.watch import EVENTS, EventLog, EventWriter, rounded, write_events
from ..io.detections import Detections, given_boxes, with_boxes
from ..io.files import LineWriter, MaskWriter, segment_pattern, write_image
from ..io.row_log import RowLog
from ..io.sources.open_source import Source
from ..io.tracks import HEADER, TABLE, TrackedObject, columns_of, mot_lines, table_lines
from ..io.zones import Zones, read_zones
from ..runs.interruption import Interrupted, Outcome
from ..runs.loop import Application, Columns, Engine, Filter, Output, Sink, Start, run_film
from ..runs.memory import BACKGROUND
from ..runs.region import inside, read_region
from ..view.film import Film
from ..view.overlay import Draw, TracksOverlay
from ..view.page import Page
from .job import WHOLE_FILM, BackgroundJob, Camera
from .job import Engine as EngineName
from .moving_camera import FIRST_FRAME, MOVES, CameraWatch, in_first_frame
from .page import RunRecord, background_page, view_row_of
from .parameters import SECTIONS, Parameters, build_chain, other_chains, read_parameters
from .predictions import SAVED as PREDICTIONS
from .predictions import Predictions
from .whole_film import read_whole, warmed_up

CHANNELS = 3
"""Bytes of a pixel in a picture that is held."""

SAMPLE = 300
"""Bytes per pixel, of the pictures in which the empty scene is found."""

EVIDENCE_EVERY = 25
"""Frames between two values of log p(I): nothing else needs that pass over the pixels."""


@checked
def build_model(
    engine: EngineName = "recursive-bp", parameters: Parameters | None = None, camera: Camera = "fixed"
) -> MultiChain:
    """Connect the background application's chains.

    Parameters
    ----------
    engine
        `"recursive-bp"`: background, blobs, ground plane and a detector's rates correct each other.
        `"feed-forward"`: the same chains without messages from the blobs to the background. `"stand-alone"`:
        the background only. `"coordinate-ascent"`: the filter for a whole video, the same as
        `"recursive-bp"`.
    parameters
        parameters that differ from the defaults, by section and name; `model` of a section selects the chain.
        Chains of other packages are in the section `chains`, by the names of their entry points, and are
        connected to the features of their ports.
    camera
        `"moving"`: a chain follows the camera, and all others work in the coordinates of its present scene.

    Raises
    ------
    ValueError
        if there is no such engine or chain, a parameter is out of range, or a chain has no port for the
        features.
    """
    background, blobs, ground, detector, motion = (
        build_chain(section, parameters or {}) for section in SECTIONS
    )
    objects, model = ObjectBoxes(), MultiChain()
    pixels: PixelLabels = PixelLabels()
    if camera == "moving":
        pixels = scene_pixels = ScenePixels()
        model.connect(motion, scene_pixels)
    model.connect(background, pixels)
    if engine == "stand-alone":
        return model
    feedback = engine in ("recursive-bp", WHOLE_FILM)
    model.connect(blobs, pixels, feedback=feedback).connect(blobs, objects).connect(ground, objects)
    model.connect(detector, objects)
    for name, chain in other_chains(parameters or {}).items():
        met = [node for node in (pixels, objects) if any(isinstance(node, port.kind) for port in chain.ports)]
        if not met:
            raise ValueError(f"--chain: {name} meets none of {pixels.name}, {objects.name}")
        for node in met:
            model.connect(chain, node, feedback=feedback)
    return model


@dataclass(frozen=True)
class FrameResult:
    """What was found in a frame: the foreground `(height, width)` uint8, 0 or 255, and objects."""

    foreground: NDArray[np.uint8]
    tracks: list[TrackedObject]


def read_frame_result(
    belief: Belief, size: tuple[int, int], region: NDArray[np.uint8] | None = None
) -> FrameResult:
    """Read mask and tracks from a belief, where the frame shows them, whatever the camera has moved.

    Of a frame without image, they are what the chains predict. Where the `region` `(height, width)` is 0, the
    mask is, and tracks that stand there are left out; `size` is `(width, height)` px.
    """
    if not belief.states:  # no image yet
        return FrameResult(np.zeros((size[1], size[0]), np.uint8), [])
    pixels: PixelMessage = belief["pixels"]
    foreground = pixels.foreground()
    tracks: list[Any] = belief["blobs"].tracks() if "blobs" in belief.states else []
    if pixels.view is not None:
        foreground = pixels.view.map.warp_to_frame(foreground)
        view = belief["camera"].view  # of the states, which is not that of messages where a scene begins
        tracks = [track.seen_by(view) for track in tracks]
    if region is not None:
        foreground &= region
        tracks = inside(region, tracks)
    return FrameResult(foreground, tracks)


def run_background(job: BackgroundJob) -> Outcome:
    """Run the background application; see `run_film`."""
    return run_film(Background(job))


class Background(Application[BackgroundJob]):
    """Masks, tracks and events of a film, measured by what is known of it."""

    name = "background"
    blank_is_missing = False
    schema: ClassVar[dict[str, Any]] = {
        "scores": SCORES,
        "trajectories": ObjectsOverTime | None,
        "predictions": PREDICTIONS,
        "camera": tuple[float, float] | None,
    }

    def __init__(self, job: BackgroundJob) -> None:
        super().__init__(job)
        parameters = read_parameters(job.config, job.chain)
        self._filter = RecursiveBP(build_model(job.engine, parameters, job.camera))
        self._region: NDArray[np.uint8] | None = None
        self._zones: Zones | None = None
        self._events: EventLog | None = None
        self._scoring: Scoring | None = None
        self._trajectories: ObjectsOverTime | None = None
        self._detections: Detections | None = None
        self._predictions = Predictions(self._filter.model) if self.predicts else None

    @property
    def files(self) -> list[str]:
        """Masks as the job wants them, tracks, and the empty scene."""
        masks = {
            "none": [],
            "png": ["foreground/bin[0-9]*.png"],
            "video": ["foreground.mkv", segment_pattern("foreground.mkv")],
        }
        more = [FILE] if self.predicts else []
        more += [EVENTS] if self.job.zones else []
        more += [FIRST_FRAME] if self.job.first_frame else []
        return ["tracks.txt", TABLE, "background.png", *masks[self.job.masks], *more]

    @property
    def begins_settled(self) -> bool:
        """Whether the empty scene is found before the first frame is answered."""
        return self.job.warm_up is not None or self.job.engine == WHOLE_FILM

    @property
    def predicts(self) -> bool:
        """Whether there are chains to compare, which have not heard of frames that they predict."""
        return self.job.engine != "stand-alone" and not self.begins_settled

    def bytes_needed(self, source: Source) -> tuple[float, float]:
        """Depends on the model of the background."""
        per_pixel = BACKGROUND[self.settings["background"]["model"]]
        if self.job.warm_up is not None:
            per_pixel += CHANNELS * math.ceil(self.job.warm_up * source.rate / self.job.step)
        return per_pixel + (SAMPLE if self.begins_settled else 0), 0.0

    def title(self, source: str) -> str:
        """The source and how it was taken."""
        return f"{Path(source).name}: {self.job.engine}"

    def build(self, start: Start) -> Engine:
        """Read what is known of the film beforehand; find the empty scene, where that is asked for."""
        job, source, model = self.job, start.source, self._filter.model
        self._start = start
        self._detections = given_boxes(job.detections, job.class_names, source, job.start, job.stop, job.step)
        start.frames = self._with_detections(start.frames)
        self._region = read_region(job.roi, source.size) if job.roi else None
        self._zones = read_zones(job.zones, source.size) if job.zones else None
        self._scoring = scoring_of(job.ground_truth, source, job.start, job.step, self._region)
        noticed = job.camera == "moving" or any(note.startswith(MOVES) for note in start.notes)
        self._camera = CameraWatch(noticed=noticed)
        self._engine = Filter(self._filter, self._begun(start, model))
        return self._engine

    def _begun(self, start: Start, model: MultiChain) -> RunState:
        """The state before the first frame."""
        job = self.job
        if start.resumed:
            state, memory = start.state(model), start.memory(self.schema) or {}
            with start.restoring():
                self._trajectories = memory["trajectories"]
                self._camera.restore(memory["camera"])
                if self._scoring is not None:
                    self._scoring.restore(memory["scores"])
                if self._predictions is not None:
                    self._predictions.restore(memory["predictions"], state)
            return state
        if job.engine == WHOLE_FILM:
            state, self._trajectories = read_whole(
                job, start.source, model, self._with_detections, start.interruption
            )
            return state
        if job.warm_up is not None:
            state, start.frames = warmed_up(job.warm_up, start.frames, model)
            if start.interruption.signal is not None and not start.source.live:
                # of fewer frames another scene is found than a run that is resumed would go on with
                raise Interrupted(start.interruption.signal)
            return state
        return start.state(model)

    def _with_detections(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        return frames if self._detections is None else with_boxes(frames, self._detections)

    def columns(self, belief: Belief) -> Columns:
        """Objects, the mask, and what has happened to zones."""
        frame = belief.frame
        found = read_frame_result(belief, self._start.source.size, self._region)
        foreground, tracks = found.foreground, found.tracks
        if self._trajectories is not None:
            tracks = inside(self._region, self._trajectories.at(len(self._log)))
        if self._predictions is not None:
            self._predictions.on_frame(belief)
        if (moves := self._camera.on_frame(belief, foreground)) is not None:
            self._start.notes.append(moves)
        if self._scoring is not None:
            self._scoring.add(frame.number, foreground)
        objects = columns_of(tracks)
        events = () if self._events is None else self._events.add(frame.number, frame.time, objects)
        seen = frame.image is not None
        due = seen and len(self._log) % EVIDENCE_EVERY == 0
        camera = belief.states.get("camera")
        moved = {} if self.job.camera == "fixed" else {"camera": np.zeros(UNKNOWNS)}
        if camera is not None:
            moved["camera"] = camera.map_of_first.parameters
        return Columns(
            {
                "foreground": np.count_nonzero(foreground) / foreground.size if seen else np.nan,
                "log_evidence": belief.log_evidence / foreground.size if due else np.nan,
                **moved,
            },
            objects,
            pictures={"mask": foreground},
            view_row=partial(view_row_of, foreground, tracks, frame.boxes),
            live={"tracks": len(tracks)},
            events=events,
        )

    def drawing(self) -> Draw:
        """Foreground, boxes, trails and zones."""
        return TracksOverlay(self._zones)

    def sinks(self, output: Output) -> list[Sink]:
        """Tracks, masks and events."""
        folder, after, self._log = output.folder, output.resume_after, output.log
        masks = MaskWriter(folder, self.job.masks, output.rate, after)

        def lines(name: str, header: Sequence[str], lines_of: Callable[..., list[str]]) -> Sink:
            earlier = (
                line
                for row, objects in output.log.frames()
                for line in lines_of(int(row["number"]), float(row["time"]), objects)
            )
            file = LineWriter(folder / name, itertools.chain(header, earlier))
            return Sink(
                lambda frame, columns: file.append(lines_of(frame.number, frame.time, columns.objects)), file
            )

        sinks = [
            lines("tracks.txt", (), mot_lines),
            lines(TABLE, (HEADER,), table_lines),
            Sink(
                lambda frame, columns: masks.write(columns.pictures["mask"], frame.number, frame.time), masks
            ),
        ]
        if self._zones is not None:
            self._events = EventLog(self._zones, output.log)
            events = EventWriter(folder / EVENTS, self._events.events)
            sinks.append(Sink(lambda _, columns: events.write(columns.events), events))
        return sinks

    def state_dict(self) -> dict[str, Any]:
        """Scores, who was where in a film that was read as a whole, predictions, the camera."""
        return {
            "scores": None if self._scoring is None else self._scoring.saved(),
            "trajectories": self._trajectories,
            "predictions": None if self._predictions is None else self._predictions.saved(),
            "camera": self._camera.saved(),
        }

    def finish(self, log: RowLog) -> dict[str, Any]:
        """Write predictions, the empty scene and all events; measures against ground truth."""
        out, states = self.job.out, self._engine.state.states
        if self._predictions is not None:
            write_predictions(out, self._predictions.records())
        if states:
            write_image(out / "background.png", states["background"].picture())
        if self.job.first_frame:
            size = self._start.source.size[::-1]
            lines = [HEADER]
            for row, objects in log.frames():
                if objects:
                    objects = in_first_frame(objects, row["camera"], size)
                lines += table_lines(int(row["number"]), float(row["time"]), objects)
            write_text(out / FIRST_FRAME, "".join(f"{line}\n" for line in lines))
        if self._events is not None:
            self._events.end(int(log["number"][-1]) if len(log) else 0)
            write_events(out / EVENTS, self._events.events)
        zone_events = self._zone_events(log)
        metrics = given = None
        if self._scoring is not None:
            tracked = self.job.engine != "stand-alone"
            metrics = self._scoring.measures(boxes_of(log) if tracked else None)
        if self._detections is not None:
            given = self._detections.counted(set(log["number"][~log["missing"]].tolist()))
        return {
            "tracks": len(np.unique(log.objects("id"))),
            "detections": given,
            "metrics": metrics,
            "events": None if zone_events is None else zone_events.counts(),
        }

    def _zone_events(self, log: RowLog) -> ZoneEvents | None:
        """What has happened to zones, as `events.csv` has it."""
        if self._zones is None or self._events is None:
            return None
        span = (float(log["time"][0]), float(log["time"][-1])) if len(log) else (0.0, 0.0)
        return ZoneEvents(self._zones, [rounded(event) for event in self._events.events], span)

    def page(self, log: RowLog, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """Tracks over the film, and what is to be said of them."""
        states = self._engine.state.states
        background = states["background"].picture() if states else None
        title, zone_events = self.title(summary["source"]), self._zone_events(log)
        return background_page(title, RunRecord(log), summary, film, background, zone_events)

    def in_words(self, summary: Mapping[str, Any]) -> list[str]:
        """Tracks, and measures against ground truth."""
        frames, rate = summary["frames"], summary["frames_per_second"]
        words = f"{frames} frames, {rate:.1f} a second, {summary['tracks']} tracks"
        if summary["missing_frames"]:
            words += f", {summary['missing_frames']} frames missing or unreadable"
        if summary["detections"]:
            words += ", {boxes} detections in {frames} frames".format(**summary["detections"])
        if summary["truncated"]:
            words += ", the source ends before its announced end"
        return [words, *(f"{group}: {_listed(of)}" for group, of in (summary["metrics"] or {}).items())]


def boxes_of(log: RowLog) -> NDArray[np.float64]:
    """Frame, identity, x, y, width and height `(n, 6)` of all objects, as `tracks.txt` has them."""
    places = [[round(float(value) + 1, 2) - 1 for value in log.objects(name)] for name in ("x", "y")]
    sizes = [[round(float(value), 2) for value in log.objects(name)] for name in ("width", "height")]
    frames = np.repeat(log["number"], log["objects"])
    return np.column_stack([frames, log.objects("id"), *places, *sizes]).astype(np.float64)


def _listed(measured: object) -> str:
    if not isinstance(measured, Mapping):
        return str(measured)
    return ", ".join(
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in measured.items()
    )
