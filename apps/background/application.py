"""The background application: from a source of frames to masks, tracks, pictures and a page."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, get_args

import numpy as np
from numpy.typing import NDArray

from ...chains.objects.object_trajectories import ObjectsOverTime
from ...inference import Belief, MultiChain, RecursiveBP
from ...models import Frame, ObjectBoxes, PixelLabels, PixelMessage, ScenePixels
from ..drawing.overlay import Draw, TracksOverlay
from ..evaluation.predictions import FILE, write_predictions
from ..evaluation.scoring import Scoring, scoring_of
from ..evaluation.tracks import track_rows
from ..events.report import Happened
from ..events.watch import EVENTS, EventWriter, read_events
from ..events.zones import Zones, read_zones
from ..exports.track_table import TABLE, TrackTableWriter
from ..io.detections import Detections, given_boxes, with_boxes
from ..io.files import write_image
from ..io.masks import MaskWriter
from ..io.mot import TrackedObject, TrackWriter, read_tracks
from ..io.segments import segment_pattern
from ..io.tables import digest
from ..runs.film_run import FilmRun, Writer
from ..runs.interruption import Interrupted, Outcome
from ..runs.memory import BACKGROUND
from ..runs.region import inside, read_region
from ..runs.saved_run import SavedRun
from ..view.film import Film, Row
from ..view.page import Page
from .job import WHOLE_FILM, BackgroundJob, Camera, Engine
from .moving_camera import MOVES, CameraWatch
from .page import background_page, drawn_of
from .parameters import (
    SECTIONS,
    Parameters,
    build_chain,
    other_chains,
    read_parameters,
    with_defaults,
)
from .predictions import Predictions
from .record import RunRecord
from .whole_film import read_whole, warmed_up

ENGINES: tuple[Engine, ...] = get_args(Engine)

CHANNELS = 3
"""Bytes of a pixel in a picture that is held."""

SAMPLE = 300
"""Bytes per pixel, of the pictures in which the empty scene is found."""

EVIDENCE_EVERY = 25
"""Frames between two values of log p(I) on the page: nothing else needs that pass over the pixels."""


def build_model(
    engine: Engine = "recursive-bp", parameters: Parameters | None = None, camera: Camera = "fixed"
) -> MultiChain:
    """Connect the background application's chains.

    Parameters
    ----------
    engine
        `"recursive-bp"`: background, blobs, ground plane and a detector's rates correct each other.
        `"feed-forward"`: the same chains, but the background hears nothing of the blobs. `"stand-alone"`: the
        background by itself.
        `"coordinate-ascent"`: the filter by which a whole film is read, the same as `"recursive-bp"`.
    parameters
        those of the chains that differ from their defaults, by section and name; a section's `model` says
        which chain it is. Chains of others are in the section `chains`, by the names under which they are
        announced, and are connected to the features that they meet.
    camera
        `"moving"`: a chain follows the camera, and all others hear of a scene that stands still.

    Raises
    ------
    ValueError
        if there is no such engine or chain, a parameter is out of range, or a chain meets none of the
        features.
    """
    if engine not in ENGINES:
        raise ValueError(f"engine: got {engine!r}, expected one of {', '.join(ENGINES)}")
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
class Found:
    """What was found in a frame.

    Parameters
    ----------
    foreground
        `(height, width)` uint8, 0 or 255.
    tracks
        objects with boxes in px, identities, and what else is known of them.
    """

    foreground: NDArray[np.uint8]
    tracks: list[TrackedObject]


def found_in(belief: Belief, size: tuple[int, int], region: NDArray[np.uint8] | None = None) -> Found:
    """Read mask and tracks from a belief; of a frame without image, they are what the chains predict.

    Parameters
    ----------
    belief
        after the frame.
    size
        `(width, height)` px.
    region
        `(height, width)` uint8: the mask is 0 where this is, and tracks that stand there are left out.

    Returns
    -------
    found
        where the frame shows it, whatever the camera has moved; the region moves along.
    """
    if not belief.states:  # no image yet
        return Found(np.zeros((size[1], size[0]), np.uint8), [])
    pixels: PixelMessage = belief["pixels"]
    foreground = pixels.foreground()
    if region is not None:
        foreground &= region
    tracks: list[Any] = inside(region, belief["blobs"].tracks() if "blobs" in belief.states else [])
    if pixels.view is None:
        return Found(foreground, tracks)
    view = pixels.view.map
    return Found(view.in_frame(foreground), [track.seen_by(view) for track in tracks])


def run_background(job: BackgroundJob) -> Outcome:
    """Run the background application; see `FilmRun.carry_out`."""
    return BackgroundRun(job).carry_out()


class BackgroundRun(FilmRun[BackgroundJob]):
    """One run: masks, tracks, and the record for the page."""

    application = "background"
    blank_is_missing = False
    kinds: ClassVar[dict[str, Any]] = {
        "record": Any,
        "scores": Any,
        "trajectories": ObjectsOverTime | None,
        "predictions": Any,
        "camera": Any,
    }

    def __init__(self, job: BackgroundJob) -> None:
        super().__init__(job)
        parameters = read_parameters(job.config, job.chain)
        self.settings |= with_defaults(parameters)
        for name, file in (("detections", job.detections), ("zones", job.zones)):
            if file is not None:
                self.settings[name] = {"file": str(file.resolve()), "sha256": digest(file)}
        self.engine = RecursiveBP(build_model(job.engine, parameters, job.camera))
        self.record = RunRecord()
        self._region: NDArray[np.uint8] | None = None
        self._zones: Zones | None = None
        self._events: EventWriter | None = None
        self._scoring: Scoring | None = None
        self._trajectories: ObjectsOverTime | None = None
        self._detections: Detections | None = None
        self._camera = CameraWatch(noticed=job.camera == "moving")
        self._predictions = Predictions(self.engine.model) if self.predicts else None

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
        return ["tracks.txt", TABLE, "background.png", *masks[self.job.masks], *more]

    @property
    def chains(self) -> Mapping[str, Any]:
        """Those of the engine."""
        return self.engine.model.chains

    @property
    def bytes_needed(self) -> tuple[float, float]:
        """Depends on the model of the background."""
        per_pixel = BACKGROUND[self.settings["background"]["model"]]
        if self.job.warm_up is not None:
            per_pixel += CHANNELS * math.ceil(self.job.warm_up * self.source.rate / self.job.step)
        return per_pixel + (SAMPLE if self.begins_settled else 0), 0.0

    @property
    def begins_settled(self) -> bool:
        """Whether the empty scene is found before the first frame is answered."""
        return self.job.warm_up is not None or self.job.engine == WHOLE_FILM

    @property
    def predicts(self) -> bool:
        """Whether there are chains to compare, which have not heard of frames that they predict."""
        return self.job.engine != "stand-alone" and not self.begins_settled

    def memory(self) -> dict[str, Any]:
        """Record and scores, who was where in a film that was read as a whole, predictions, the camera."""
        scores = None if self._scoring is None else self._scoring.saved()
        return {
            "record": self.record.saved(),
            "scores": scores,
            "trajectories": self._trajectories,
            "predictions": None if self._predictions is None else self._predictions.saved(),
            "camera": self._camera.saved(),
        }

    def known(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """What a detector has found in the frames."""
        job = self.job
        self._detections = given_boxes(
            job.detections, job.class_names, self.source, job.start, job.stop, job.step
        )
        return self._with_detections(frames)

    def _with_detections(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        return frames if self._detections is None else with_boxes(frames, self._detections)

    def begin(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Read region and ground truth; find the empty scene, where that is asked for."""
        job, model = self.job, self.engine.model
        self._read_masks()
        if job.engine == WHOLE_FILM:
            self.state, self._trajectories = read_whole(
                job, self.source, model, self._with_detections, self.interruption
            )
        if job.warm_up is not None:
            self.state, frames = warmed_up(job.warm_up, frames, model)
            if self.interruption.signal is not None and not self.source.live:
                # of fewer frames another scene is found than a run that is resumed would go on with
                raise Interrupted(self.interruption.signal)
        return frames

    def _read_masks(self) -> None:
        self._region = read_region(self.job.roi, self.source.size) if self.job.roi else None
        self._zones = read_zones(self.job.zones, self.source.size) if self.job.zones else None
        self._scoring = scoring_of(
            self.job.ground_truth, self.source, self.job.start, self.job.step, self._region
        )

    def go_on(self, memory: Mapping[str, Any]) -> None:
        """Take up record and scores."""
        self._read_masks()
        self._trajectories = memory["trajectories"]
        self.record = RunRecord.restored(memory["record"])
        said = any(note.startswith(MOVES) for note in self.notes)
        self._camera = CameraWatch(noticed=said or self.job.camera == "moving")
        self._camera.restore(memory["camera"])
        if self._scoring is not None:
            self._scoring.restore(memory["scores"])
        if self._predictions is not None:
            self._predictions.restore(memory["predictions"], self.state)

    def learn_from(self, saved: SavedRun) -> None:
        """The states are all there is to learn."""
        self._read_masks()

    def writers(self, rate: float, after: int) -> list[Writer]:
        """Tracks, masks and events."""
        out = self.job.out
        self._tracks = TrackWriter(out / "tracks.txt", after)
        self._table = TrackTableWriter(out / TABLE, after)
        self._masks = MaskWriter(out, self.job.masks, rate, after)
        growing: list[Writer] = [self._tracks, self._table, self._masks]
        if self._zones is not None:
            self._events = EventWriter(out / EVENTS, self._zones, out / TABLE, after)
            growing.append(self._events)
        return growing

    def found(self, belief: Belief) -> Found:
        """Mask and tracks."""
        found = found_in(belief, self.source.size, self._region)
        if self._trajectories is None:
            return found
        tracks = self._trajectories.at(len(self.record.numbers))
        return Found(found.foreground, inside(self._region, tracks))

    def take_in(self, belief: Belief, found: Found, seconds: float) -> None:
        """Write mask and tracks, and note what the page wants."""
        frame = belief.frame
        self._tracks.write(frame.number, found.tracks)
        self._table.write(frame.number, frame.time, found.tracks)
        if self._events is not None:
            happened = self._events.write(frame.number, frame.time, found.tracks)
            self.news = [event.in_words() for event in happened]
        self._masks.write(found.foreground, frame.number, frame.time)
        if self._predictions is not None:
            self._predictions.take_in(belief)
        if (said := self._camera.take_in(belief, found.foreground)) is not None:
            self.notes.append(said)
        if self._scoring is not None:
            self._scoring.add(frame.number, found.foreground)

        due = len(self.record.numbers) % EVIDENCE_EVERY == 0
        self.record.add(
            frame,
            found.tracks,
            found.foreground,
            belief.log_evidence if due else np.nan,
            seconds,
        )

    def facts(self) -> dict[str, Any]:
        """Tracks, and measures against ground truth."""
        metrics = None
        if self._scoring is not None:
            tracked = self.job.engine != "stand-alone"
            rows = track_rows(read_tracks(self.job.out / "tracks.txt")) if tracked else None
            metrics = self._scoring.measures(rows)
        given = None
        if self._detections is not None:
            given = self._detections.counted(set(self.record.numbers) - set(self.record.missing))
        happened = self._happened
        events = None if happened is None else happened.counts()
        return {
            "tracks": len(self.record.tracks),
            "detections": given,
            "metrics": metrics,
            "events": events,
        }

    @cached_property
    def _happened(self) -> Happened | None:
        """To zones, when all frames are done."""
        if self._zones is None:
            return None
        times = self.record.times
        span = (times[0], times[-1]) if times else (0.0, 0.0)
        return Happened(self._zones, read_events(self.job.out / EVENTS), span)

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Write predictions and the empty scene."""
        job = self.job
        if self._predictions is not None:
            write_predictions(job.out, self._predictions.records())
        if self.state.states:
            write_image(job.out / "background.png", self.state.states["background"].picture())

    def drawn(self, belief: Belief, found: Found) -> Callable[[], Row]:
        """Boxes and outlines."""
        return partial(drawn_of, found.foreground, found.tracks, belief.frame.boxes)

    def drawing(self) -> Draw:
        """Foreground, boxes, trails and zones."""
        return TracksOverlay(self._zones)

    def told(self, belief: Belief, found: Found) -> dict[str, object]:
        """How many are there."""
        return {"tracks": len(found.tracks)}

    @property
    def title(self) -> str:
        """The source and how it was taken."""
        return f"{Path(self.source.name).name}: {self.job.engine}"

    def page(self, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """Tracks over the film, and what is to be said of them."""
        background = self.state.states["background"].picture() if self.state.states else None
        return background_page(self.title, self.record, summary, film, background, self._happened)

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


def _listed(measured: object) -> str:
    if not isinstance(measured, Mapping):
        return str(measured)
    return ", ".join(
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in measured.items()
    )
