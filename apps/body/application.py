"""The body application: from a film of a person to the pose of the upper body in every frame."""

import logging
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...chains.body.articulated_pose import ArticulatedPose
from ...chains.body.dynamics import BodyDynamics
from ...chains.body.fixed_lag import BLOCK, FixedLag, TimedSamples, WaitingFrame
from ...chains.body.flesh_tracker import FleshTracker
from ...inference import Belief, MultiChain, RecursiveBP
from ...models.body.parts import CALIBRATION_FRAMES
from ...models.body.upper_body import PARTS
from ...models.core.frame import Frame
from ..drawing.overlay import Draw
from ..io.film import SeenFrames
from ..io.keypoints import Keypoints, digest_of, given_keypoints, with_keypoints
from ..io.segments import segment_pattern
from ..io.sources.open_source import open_source
from ..runs.film_run import FilmRun, Step, Writer
from ..runs.interruption import Interrupted, Outcome
from ..runs.memory import BODY, KEPT_IMAGE, KEPT_SAMPLE, SAMPLE
from ..runs.saved_run import SavedRun
from ..view.film import Film, Row
from ..view.page import Page
from .job import LAG, BodyJob
from .joint_files import ClickedJoints, read_joints
from .keypoint_start import followed, shows_whom, start_from_keypoints, with_lengths
from .page import body_page, drawing, drawn_of, with_final_names
from .record import BodyRecord
from .start import BodyStart, SavedPerson, read_head, start_from_faces, start_from_head
from .writer import BodyWriter, lengths

_log = logging.getLogger(__name__)

Image = NDArray[np.uint8]

SPREAD_OVER = 1000
"""Frames of a video over which those are spread in which faces are looked for: all of these are decoded."""


def run_body(job: BodyJob) -> Outcome:
    """Run the body application; see `FilmRun.carry_out`.

    Frames that are missing, unreadable or blank (black, saturated) are predicted.
    """
    return BodyRun(job, None if job.joints is None else read_joints(job.joints)).carry_out()


class BodyRun(FilmRun[BodyJob]):
    """One run: who is tracked, the poses, and the record for the page."""

    application = "body"
    files = ("poses.npz", segment_pattern("poses.npz"))
    kinds: ClassVar[dict[str, Any]] = {
        "person": SavedPerson,
        "record": BodyRecord.kinds(),
        "draws": np.random.Generator,
        "answered": WaitingFrame | None,
    }
    chains: ClassVar[dict[str, Any]] = {"flesh": FleshTracker, "pose": ArticulatedPose}

    def __init__(self, job: BodyJob, clicked: ClickedJoints | None) -> None:
        super().__init__(job)
        if job.keypoints is not None:
            self.settings["keypoints"] = {
                "file": self.settings["keypoints"],
                "sha256": digest_of(job.keypoints),
            }
        self._keypoints: Keypoints | None = None
        self._head = None if job.head is None else read_head(job.head)
        self._clicked = clicked
        self._draws = np.random.default_rng(job.seed)  # of the poses that are shown
        self.record = BodyRecord()

    @property
    def bytes_needed(self) -> tuple[float, float]:
        """Depends on the number of samples, and on that of frames that wait with theirs."""
        kept = self.lag + BLOCK if self.lag else 0
        return BODY + KEPT_IMAGE * kept, self.job.samples * (SAMPLE + KEPT_SAMPLE * kept)

    @property
    def lag(self) -> int:
        """Frames that are waited for before one is answered."""
        if self.job.lag is not None:
            return self.job.lag
        return 0 if self.source.live else LAG

    def memory(self) -> dict[str, Any]:
        """Who is tracked, and the record."""
        return {
            "person": SavedPerson.of(self._start),
            "record": self.record.saved(),
            "draws": self._draws,
            "answered": self._hindsight.waiting.past,
        }

    def known(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """What a detector has found in the frames."""
        job = self.job
        if job.keypoints is None:
            return frames
        self._keypoints = given_keypoints(job.keypoints, self.source, job.start, job.stop, job.step)
        return with_keypoints(frames, self._keypoints)

    def begin(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Find the person in the first frame in which anything is to be seen, and in others."""
        job, images = self.job, None
        if self._read_once:
            beginning = list(islice(frames, CALIBRATION_FRAMES))
            frames = chain(beginning, frames)
            images = [frame.image for frame in beginning if frame.image is not None]
        by_keypoints = self._keypoints is not None and self._head is None and job.detector is None
        for first in frames:
            if first.image is not None and (not by_keypoints or shows_whom(first)):
                break
            self.before.append(first.number)
        else:
            what = "a head or shoulders were found" if by_keypoints else "anything is to be seen"
            raise self.no_frame(f"holds no frame in which {what}")
        if images is None:
            images = self._looked_at()
        images = images or [first.image]  # where nothing else is to be seen in what was looked at
        start, found = self._started_from(first, images)
        _log.info("start in frame %d, by %s: %s", first.number, found, start.origin)
        self._begin_with(start)
        return chain([first], frames)

    def _started_from(self, first: Frame, images: list[Image]) -> tuple[BodyStart, str]:
        """Who is tracked, and how that was found out."""
        job, clicked, keypoints = self.job, self._clicked, self._keypoints
        if self._head is not None and job.detector is None:
            start, found = start_from_head(first, self._head, images, clicked), "the head as marked"
        elif keypoints is not None and job.detector is None:
            return start_from_keypoints(first, keypoints, images, clicked), "keypoints"
        else:
            at_first = [first.image] if self._head is not None and first.image is not None else []
            start = start_from_faces(
                self.source.name, [*at_first, *images], job.detector, clicked, self._head
            )
            found = str(job.detector or "OpenCV's cascades of faces")
        if keypoints is not None and clicked is None:
            start = with_lengths(start, followed(keypoints, first.number, start.head_in(first)))
        return start, found

    def go_on(self, memory: Mapping[str, Any]) -> None:
        """Take up the person, and the record."""
        self._draws = memory["draws"]
        self.record = BodyRecord.restored(memory["record"])
        self._begin_with(memory["person"].start(self.job.detector))
        self._hindsight.waiting = replace(self._hindsight.waiting, past=memory["answered"])

    def learn_from(self, saved: SavedRun) -> None:
        """Take the person's lengths, colour and pose."""
        self._begin_with(saved.memory["person"].elsewhere().start(self.job.detector))

    def _begin_with(self, start: BodyStart) -> None:
        self._start = start
        self._flesh = FleshTracker(start.body)
        self._pose = ArticulatedPose(start.body, self.job.samples, seed=self.job.seed)
        model = MultiChain().connect(self._flesh, start.parts).connect(self._pose, start.parts)
        self.engine = RecursiveBP(model)
        self._hindsight = FixedLag(BodyDynamics(start.body), self.lag, seed=self.job.seed)

    @property
    def _read_once(self) -> bool:
        """Whether the source cannot be read a second time."""
        return self.source.kind in ("camera", "stream")

    def _looked_at(self) -> list[Image]:
        """Images from all over the source, which is read a second time for it."""
        job, total = self.job, self.source.n_frames
        if total is not None and self.source.kind == "video":
            total = min(total, SPREAD_OVER)
        stride = 1 if total is None else -(-total // CALIBRATION_FRAMES)
        with open_source(job.source, job.start, job.stop, job.step * stride) as source:
            frames = islice(SeenFrames(self.interruption.items(source)), CALIBRATION_FRAMES)
            images = [frame.image for frame in frames if frame.image is not None]
        if self.interruption.signal is not None:
            raise Interrupted(self.interruption.signal)
        return images

    def writers(self, rate: float, after: int) -> list[Writer]:
        """Poses."""
        self._writer = BodyWriter(self.job.out, after, self._start.body, self._draws, self.record)
        return [self._writer]

    def found(self, belief: Belief) -> list[TimedSamples]:
        """Poses of the frames of which enough later ones are known by now."""
        self._begin_draws(belief.frame.number)
        image = belief.evidence(self._start.parts).image
        return self._hindsight.add(belief.frame, belief[self._pose], image)

    def answered(self, steps: Iterator[Step]) -> Iterator[Step]:
        """Frames with their poses in hindsight; of the last ones, fewer later frames are known."""
        waiting: deque[Step] = deque()

        def answer(poses: TimedSamples) -> Step:
            return replace(waiting.popleft(), found=poses)

        for step in steps:
            belief = step.belief
            # without what else is believed of the frame, which is large
            waiting.append(replace(step, belief=Belief(belief.frame, belief.state, None)))
            yield from map(answer, step.found)
        self._begin_draws(0)
        yield from map(answer, self._hindsight.rest())

    def _begin_draws(self, number: int) -> None:
        """Let what hindsight draws depend on the frame alone: a run that is resumed takes in frames again."""
        random = np.random.default_rng((self.job.seed, number))
        self._hindsight.waiting = replace(self._hindsight.waiting, random=random)

    def take_in(self, belief: Belief, found: TimedSamples, seconds: float) -> None:
        """Write the frame's poses."""
        states = belief.states
        detected = states[self._flesh.name].unseen == 0
        filtered = states[self._pose.name]
        self._row = self._writer.add(belief.frame, filtered, found, detected, seconds)

    def drawn(self, belief: Belief, found: TimedSamples) -> Callable[[], Row]:
        """Joints and some samples."""
        return partial(drawn_of, self._row)

    def drawing(self) -> Draw:
        """Skeletons, from the front and from the side."""
        return drawing(self._arm)

    @property
    def _arm(self) -> float:
        """Length of a stretched one, px."""
        body = self._start.body
        return body.upper_arm + body.forearm

    def told(self, belief: Belief, found: Any) -> dict[str, object]:
        """What of the body the image shows."""
        seen = [name.replace("_", " ") for name, so in zip(PARTS, self._row["seen"], strict=True) if so]
        return {"seen": ", ".join(seen) or "nothing"}

    @property
    def title(self) -> str:
        """The source, and what of it is followed."""
        return f"{Path(self.source.name).name}: upper body"

    def page(self, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """The body over the film and in space, and what is to be said of it."""
        if film is not None and self.record.relabelled:
            film = with_final_names(film, self.job.out)
        return body_page(self.title, self.record, summary, film, self._arm)

    def facts(self) -> dict[str, Any]:
        """What was seen, and what is assumed of the person."""
        start, given = self._start, None
        if self._keypoints is not None:
            given = self._keypoints.counted(set(self.record.numbers) - set(self.record.missing))
        return {
            "seen": self.record.shares_seen,
            "stationary": self.record.stationary_periods,
            "keypoints": given,
            "doubts": self.record.doubts,
            "relabelled": self.record.relabelled,
            "flesh_colour": start.parts.skin is not None,
            "body": {"origin": start.origin, "lengths": lengths(start.body)},
            "notes": [*start.notes, *self.record.notes, *self._about_video()],
        }

    def _about_video(self) -> list[str]:
        if not (self.job.video and self.record.relabelled):
            return []
        return [
            "overlay.mp4 shows the names of the hands as they were before; rsmcm export --to video has the "
            "new ones."
        ]

    def in_words(self, summary: Mapping[str, Any]) -> list[str]:
        """How much was seen."""
        shares = ", ".join(f"{name.replace('_', ' ')} {100 * s:.0f} %" for name, s in summary["seen"].items())
        return [f"{summary['frames']} frames, {summary['frames_per_second']:.1f} a second, seen: {shares}"]
