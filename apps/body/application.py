"""The body application: from a film of a person to the pose of the upper body in every frame."""

import logging
from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from ...chains.body.articulated_pose import ArticulatedPose
from ...chains.body.dynamics import BodyDynamics
from ...chains.body.fixed_lag import (
    BLOCK,
    FixedLag,
    SmoothedBelief,
    Smoother,
    TimedSamples,
    WaitingFrame,
)
from ...chains.body.flesh_state import FleshTracks
from ...chains.body.flesh_tracker import FleshTracker
from ...chains.body.hand_labelling import relabel_hands
from ...chains.body.samples import body_moments, hypotheses
from ...chains.body.start import (
    BodyStart,
    SavedPerson,
    fit_lengths,
    follow_person,
    shows_person,
    start_from_faces,
    start_from_head,
    start_from_keypoints,
)
from ...inference import Belief, MultiChain, RecursiveBP
from ...models.body.parts import CALIBRATION_FRAMES
from ...models.body.upper_body import JOINTS, PARTS, UpperBody
from ...models.core.frame import BoundingBox, Frame
from ..io.film import SeenFrames
from ..io.keypoints import Keypoints, given_keypoints, with_keypoints
from ..io.row_log import RowLog
from ..io.sources.open_source import Source, open_source
from ..runs.interruption import Interrupted, Outcome
from ..runs.loop import Application, Columns, Engine, Start, run_film
from ..runs.memory import BODY, KEPT_IMAGE, KEPT_SAMPLE, SAMPLE
from ..view.film import Film
from ..view.overlay import Draw
from ..view.page import Page
from .job import LAG, BodyJob
from .page import BodyRecord, body_page, drawing, view_row_of, with_final_names

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

N_DRAWN = 40  # poses of each frame that are saved, as many as in Figs. 4 to 6 of the paper

ANGLE_NAMES = (
    "root_x", "root_y", "torso_x", "torso_y", "torso_z", "neck_x", "neck_y", "neck_z",
    "left_shoulder_x", "left_shoulder_y", "left_shoulder_z", "left_elbow",
    "right_shoulder_x", "right_shoulder_y", "right_shoulder_z", "right_elbow",
)  # fmt: skip
"""Of `BodyPoses.angles`: px for the root; rotation vectors and flexions of the elbows, rad."""

POSES = (
    "joints_2d", "joints_2d_covariances", "joints_3d", "joints_3d_covariances", "angles", "angle_covariances",
    "samples", "hypotheses", "hypothesis_joints", "seen", "seen_probability", "stationary", "missing",
)  # fmt: skip
"""Columns of `poses.npz`, a row a frame, beside `frames` (their numbers) and `times` s: posterior means and
covariances `joints_2d (8, 2)` px, `joints_2d_covariances (8, 2, 2)`, `joints_3d (8, 3)`,
`joints_3d_covariances (8, 3, 3)`, `angles (16,)`, `angle_covariances (16, 16)`; `samples (40, 8, 3)` px,
joints of poses drawn from the posterior; `hypotheses (4,)`, probabilities of hypotheses that differ in where
the hands are, the best one first, and `hypothesis_joints (4, 8, 3)` px, their means, NaN where there are
fewer; `seen_probability (3,)` that head, left hand and right hand are visible where they are stated to be
(before the face as often as hands are: its skin may be all one sees), and `seen (3,)`, whether it is above
one half; `stationary`, whether nothing at all was detected; `missing`, whether there was no image. Given the
whole film: `exchanged`, the probability of exchanged hands, and `relabelled`, whether hands were exchanged at
the end because of it. `joint_names (8,)`, `part_names (3,)` (of `seen`), `angle_names (16,)`, and the body's
`length_names` and `lengths` px come once. x is to the right, y down, z away from the viewer, 0 at the root;
left is the person's own."""

NEAR_MEAN = 0.5  # head heights: a hand that is farther from its stated position is elsewhere
SPREAD = 4.0
"""Square of the factor, typically, by which hands lie farther from the posterior's mean than its samples do.
Measured by `rsmcm reproduce calibration`."""

MOST_DECODED = 1000  # frames of a video in which calibration frames are, since all up to them are decoded


def run_body(job: BodyJob) -> Outcome:
    """Run the body application; see `run_film`.

    Frames that are missing, unreadable or blank (black, saturated) are predicted.
    """
    return run_film(Body(job))


def read_head(text: str) -> BoundingBox:
    """Read `x,y,width,height` px of a head; raise `ValueError` for any other text, or an empty box."""
    try:
        x, y, width, height = (float(number) for number in text.split(","))
    except ValueError:
        raise ValueError(f"--head: got {text!r}, expected x,y,width,height in px") from None
    if not (np.isfinite([x, y]).all() and 0 < width < np.inf and 0 < height < np.inf):
        raise ValueError(f"--head: got {text!r}, expected a width and height above 0 px")
    return x, y, width, height


class Body(Application[BodyJob]):
    """The body application: a person's poses with their uncertainty."""

    name = "body"
    files = ("poses.npz",)
    schema: ClassVar[dict[str, Any]] = {
        "person": SavedPerson,
        "draws": np.random.Generator,
        "answered": WaitingFrame | None,
    }

    def __init__(self, job: BodyJob) -> None:
        super().__init__(job)
        self._keypoints: Keypoints | None = None
        self._head = None if job.head is None else read_head(job.head)
        self._draws = np.random.default_rng(job.seed)  # of the poses that are shown

    def bytes_needed(self, source: Source) -> tuple[float, float]:
        """Memory of the samples, and of the frames that wait to be smoothed."""
        lag = self._lag(source)
        kept = lag + 2 * BLOCK if lag else 0
        return BODY + KEPT_IMAGE * kept, self.job.samples * (SAMPLE + KEPT_SAMPLE * kept)

    def _lag(self, source: Source) -> int:
        """Later frames that are waited for before one is smoothed."""
        if self.job.lag is not None:
            return self.job.lag
        return 0 if source.live else LAG

    def build(self, start: Start) -> Engine:
        """Connect the chains for the person of an earlier run, or one detected in the film."""
        job, source = self.job, start.source
        if job.keypoints is not None:
            self._keypoints = given_keypoints(job.keypoints, source, job.start, job.stop, job.step)
            start.frames = with_keypoints(start.frames, self._keypoints)
        memory = start.memory(self.schema)
        if memory is None:
            self._start = self._find_person(start)
        elif start.resumed:
            self._start, self._draws = memory["person"].start(job.detector), memory["draws"]
        else:
            self._start = memory["person"].elsewhere().start(job.detector)
        body, parts = self._start.body, self._start.parts
        self._flesh = FleshTracker(body)
        self._pose = ArticulatedPose(body, job.samples, seed=job.seed)
        engine = RecursiveBP(MultiChain().connect(self._flesh, parts).connect(self._pose, parts))
        smoothing = FixedLag(BodyDynamics(body), self._lag(source), seed=job.seed)
        if memory is not None and start.resumed:
            smoothing.waiting = replace(smoothing.waiting, past=memory["answered"])
        state = start.state(engine.model)
        self._smoother = Smoother(engine, state, smoothing, self._pose, parts, job.seed)
        return self._smoother

    def _find_person(self, start: Start) -> BodyStart:
        """Detect a person in the first frame that is not blank, and in others."""
        job, images = self.job, None
        if start.source.kind in ("camera", "stream"):  # which cannot be read a second time
            beginning = list(islice(start.frames, CALIBRATION_FRAMES))
            start.frames = chain(beginning, start.frames)
            images = [frame.image for frame in beginning if frame.image is not None]
        by_keypoints = self._keypoints is not None and self._head is None and job.detector is None
        for first in start.frames:
            if first.image is not None and (not by_keypoints or shows_person(first)):
                break
            start.before.append(first.number)
        else:
            found = "holds no frame in which a head or shoulders were found"
            raise start.no_frame(found if by_keypoints else "holds only blank frames")
        if images is None:
            images = self._calibration_images(start)
        images = images or [first.image]  # if all others are blank
        person, method = self._started_from(start.source, first, images)
        _log.info("start in frame %d, by %s: %s", first.number, method, person.origin)
        start.frames = chain([first], start.frames)
        return person

    def _started_from(self, source: Source, first: Frame, images: list[Image]) -> tuple[BodyStart, str]:
        """Return the person, and in words how they were detected."""
        job, keypoints = self.job, self._keypoints
        if self._head is not None and job.detector is None:
            person, method = start_from_head(first, self._head, images), "the head as marked"
        elif keypoints is not None and job.detector is None:
            return start_from_keypoints(first, keypoints, images), "keypoints"
        else:
            at_first = [first.image] if self._head is not None and first.image is not None else []
            person = start_from_faces(source.name, [*at_first, *images], job.detector, self._head)
            method = str(job.detector or "OpenCV's cascades of faces")
        if keypoints is not None:
            person = fit_lengths(person, follow_person(keypoints, first.number, person.head_in(first)))
        return person, method

    def _calibration_images(self, start: Start) -> list[Image]:
        """Read images from all over the source, which is opened a second time for it."""
        job, total = self.job, start.source.n_frames
        if total is not None and start.source.kind == "video":
            total = min(total, MOST_DECODED)
        stride = 1 if total is None else -(-total // CALIBRATION_FRAMES)
        with open_source(job.source, job.start, job.stop, job.step * stride) as source:
            frames = islice(SeenFrames(start.interruption.items(source)), CALIBRATION_FRAMES)
            images = [frame.image for frame in frames if frame.image is not None]
        if start.interruption.signal is not None:
            raise Interrupted(start.interruption.signal)
        return images

    def columns(self, belief: Belief) -> Columns:
        """Return joints and angles, their covariances, some poses of the posterior, and what was detected."""
        assert isinstance(belief, SmoothedBelief)
        frame, body, states = belief.frame, self._start.body, belief.states
        filtered, samples = states[self._pose.name], belief.samples.samples
        moments = body_moments(body, samples)
        drawn = body.joints(samples.resample(N_DRAWN, self._draws))
        probabilities = seen_probabilities(body, states[self._flesh.name], belief.samples)
        seen = probabilities > 0.5
        answers = hypotheses(body, samples, self._draws)
        row = {
            "joints_2d": moments.joints[:, :2],
            "joints_2d_covariances": moments.joint_covariances[:, :2, :2],
            "joints_3d": moments.joints,
            "joints_3d_covariances": moments.joint_covariances,
            "angles": moments.angles,
            "angle_covariances": moments.angle_covariances,
            "samples": drawn.astype(np.float32),
            "hypotheses": answers.weights,
            "hypothesis_joints": answers.joints,
            "seen": seen,
            "seen_probability": probabilities,
            "stationary": np.bool_(filtered.stationary),
            "missing": np.bool_(frame.missing),
        }
        nothing = frame.missing or filtered.stationary
        measures = {
            "log_evidence": np.float64(np.nan if nothing else filtered.log_evidence),
            "effective": np.float64(filtered.effective),
            "unsure": np.concatenate([[0.0], answers.unsure]),
            "exchange_log_odds": np.float64(belief.samples.evidence.log_odds),
            "confusable": np.float64(belief.samples.evidence.confusable),
        }
        shown = ", ".join(name.replace("_", " ") for name, so in zip(PARTS, seen, strict=True) if so)
        return Columns(
            {**row, **measures}, view_row=partial(view_row_of, row), live={"seen": shown or "nothing"}
        )

    def drawing(self) -> Draw:
        """Return what draws skeletons, from the front and from the side."""
        return drawing(self._arm)

    @property
    def _arm(self) -> float:
        """Length of a stretched arm, px."""
        return self._start.body.upper_arm + self._start.body.forearm

    def state_dict(self) -> dict[str, Any]:
        """Return the person, the random generator, and the last smoothed frame."""
        return {
            "person": SavedPerson.of(self._start),
            "draws": self._draws,
            "answered": self._smoother.answered,
        }

    def finish(self, log: RowLog) -> dict[str, Any]:
        """Write the poses with the final labels of the hands; return the summary."""
        start, given = self._start, None
        self._record = record = BodyRecord(log)
        self._poses = relabel_hands(start.body, {name: log[name] for name in POSES}, record.labels.exchanged)
        known = lengths(start.body)
        constants = {
            "joint_names": np.array(JOINTS),
            "part_names": np.array(PARTS),
            "angle_names": np.array(ANGLE_NAMES),
            "length_names": np.array(list(known)),
            "lengths": np.array(list(known.values())),
            "exchanged": record.exchanged,
            "relabelled": self._poses["relabelled"],
        }
        rows = {name: self._poses[name] for name in POSES}
        columns = {"frames": log["number"], "times": log["time"], **rows}
        log.write_arrays(self.job.out / "poses.npz", constants, columns)
        if self._keypoints is not None:
            given = self._keypoints.counted(set(record.numbers) - set(record.missing))
        notes = [*start.notes, *record.notes]
        if self.job.video and record.relabelled:
            notes.append(
                "overlay.mp4 has the labels of the hands before relabelling; rsmcm export --to video has the "
                "new ones."
            )
        return {
            "seen": record.shares_seen,
            "stationary": record.stationary_periods,
            "keypoints": given,
            "doubts": record.doubts,
            "relabelled": record.relabelled,
            "flesh_colour": start.parts.skin is not None,
            "body": {"origin": start.origin, "lengths": known},
            "notes": notes,
        }

    def title(self, source: str) -> str:
        """Return the title of the page."""
        return f"{Path(source).name}: upper body"

    def page(self, log: RowLog, film: Film | None, summary: Mapping[str, Any]) -> Page:
        """Return the page: the body over the film and in space, uncertainty and notes."""
        if film is not None and self._record.relabelled:
            film = with_final_names(film, {**self._poses, "frames": log["number"]})
        return body_page(self.title(summary["source"]), self._record, summary, film, self._arm)

    def in_words(self, summary: Mapping[str, Any]) -> list[str]:
        """Return how often each part was detected."""
        shares = ", ".join(f"{name.replace('_', ' ')} {100 * s:.0f} %" for name, s in summary["seen"].items())
        return [f"{summary['frames']} frames, {summary['frames_per_second']:.1f} a second, seen: {shares}"]


def lengths(body: UpperBody) -> dict[str, float]:
    """Return lengths and widths of a body, px, by name."""
    return {field.name: float(getattr(body, field.name)) for field in fields(body)}


def seen_probabilities(body: UpperBody, tracks: FleshTracks, smoothed: TimedSamples) -> Array:
    """`(3,)`: probability that head, left and right hand are visible, hands near the posterior's mean.

    That of the head is the probability of the hypotheses in which it was detected; see `hands_are_seen`.
    """
    samples, log_odds = smoothed.samples, smoothed.hand_log_odds
    probabilities = np.asarray(tracks.weights @ (tracks.since == 0), np.float64)
    if log_odds is not None:
        hands = body.parts(samples.poses)[:, 1:]
        away = hands - np.einsum("n,nhx->hx", samples.weights, hands)
        probabilities[1:] = samples.weights @ hands_are_seen(*apart_and_shared(body, hands, away), log_odds)
    return probabilities


def apart_and_shared(body: UpperBody, hands: Array, away: Array) -> tuple[Array, Array]:
    """How far hands are `away` `(..., 2, 2)` px over `NEAR_MEAN`, `(..., 2)`, and the share of both discs.

    That share is `(..., 1)`, of the disc of a left hand in that of a right one, at `hands` `(..., 2, 2)` px.
    """
    apart = np.linalg.norm(away, axis=-1) / (NEAR_MEAN * body.head_height)
    between = np.linalg.norm(hands[..., 0, :] - hands[..., 1, :], axis=-1, keepdims=True)
    half = np.minimum(between / (2 * body.hand), 1)
    return apart, 2 / np.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))


def hands_are_seen(apart: Array, shared: Array, log_odds: Array, spread: float = SPREAD) -> Array:
    """`(..., 2)`: probability that hands are visible, and near the mean, given a sample of both.

    Samples of a hand are about as far `apart` from the mean as frames tell that are not independent: their
    scale is known up to a factor, the square of which is `spread` over an exponential variable. The true hand
    of a Gaussian posterior then has Student's t distribution of two degrees of freedom. The skin that both
    hands would show is rather that of one: each has half of it, as far as the other one is visible at all.
    """
    shown = expit(log_odds)
    return np.asarray(np.exp(-spread * apart**2) * shown * (1 - 0.5 * shared * shown[..., ::-1]))
