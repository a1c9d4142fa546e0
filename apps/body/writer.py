"""What of a run of the body application grows with the frames: `poses.npz`, and the record."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chains.body.fixed_lag import TimedSamples
from ...chains.body.samples import BodySamples, moments
from ...models.body.upper_body import JOINTS, PARTS, UpperBody
from ...models.core.frame import Frame
from ..io.row_writer import RowWriter
from .hypotheses import hypotheses
from .record import PART_JOINTS, BodyRecord
from .relabelling import relabel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

N_DRAWN = 40
"""Samples that are drawn and kept, as in Figs. 4 to 6 of the paper."""

ANGLE_NAMES = (
    "root_x", "root_y", "torso_x", "torso_y", "torso_z", "neck_x", "neck_y", "neck_z",
    "left_shoulder_x", "left_shoulder_y", "left_shoulder_z", "left_elbow",
    "right_shoulder_x", "right_shoulder_y", "right_shoulder_z", "right_elbow",
)  # fmt: skip
"""Of `BodyPoses.angles`: px for the root; rotation vectors and flexions of the elbows, rad."""


FACE_AND_NECK = (0.45, 0.62)
"""Of the head's height: half axes of the ellipse about its centre in which skin need not be a hand's."""


class BodyWriter(RowWriter):
    """What grows with the frames: `poses.npz`, and the record for summary and page.

    `poses.npz` holds, a row a frame: `frames` (their numbers) and `times` s; posterior means and covariances:
    `joints_2d (8, 2)` px, `joints_2d_covariances (8, 2, 2)`, `joints_3d (8, 3)`, `joints_3d_covariances (8,
    3, 3)`, `angles (16,)`, `angle_covariances (16, 16)`; `samples (40, 8, 3)` px, joints of poses drawn from
    the posterior; `hypotheses (4,)`, probabilities of answers that differ in where the hands are, the best
    one first, and `hypothesis_joints (4, 8, 3)` px, their means, NaN where there are fewer; `seen (3,)`,
    whether the image has shown head, left hand and right hand (a hand before face or neck does not count,
    since their skin may be all that was seen); `stationary`, whether nothing at all was detected; `missing`,
    whether there was no image. Of the whole film: `exchanged`, the probability that left and right hand have
    each other's name, and `relabelled`, whether names were exchanged at the end because of it.
    `joint_names (8,)`, `part_names (3,)` (of `seen`), `angle_names (16,)`, and the body's `length_names` and
    `lengths` px come once. x is to the right, y down, z away from the viewer, 0 at the root; left is the
    person's own.

    Parameters
    ----------
    folder
        of the results.
    after
        number of the frame after which this run goes on; 0 for a new one.
    body
        that is tracked.
    random
        source of the draws that are shown.
    record
        to add to.
    """

    def __init__(
        self,
        folder: Path,
        after: int,
        body: UpperBody,
        random: np.random.Generator,
        record: BodyRecord,
    ) -> None:
        known = lengths(body)
        constants: dict[str, NDArray[Any]] = {
            "joint_names": np.array(JOINTS),
            "part_names": np.array(PARTS),
            "angle_names": np.array(ANGLE_NAMES),
            "length_names": np.array(list(known)),
            "lengths": np.array(list(known.values())),
        }
        super().__init__(folder / "poses.npz", constants, after)
        self._body = body
        self._random = random
        self._record = record

    def add(
        self,
        frame: Frame,
        filtered: BodySamples,
        answer: TimedSamples,
        detected: Mask,
        seconds: float,
    ) -> Mapping[str, Any]:
        """Take in a frame; its row of `poses.npz` is returned.

        Parameters
        ----------
        frame
            that was processed.
        filtered
            its posterior, given the frames up to it.
        answer
            its posterior, given later ones as well.
        detected
            `(3,)`: which parts were taken for something in the image.
        seconds
            that the tracker took.
        """
        samples = answer.samples
        found = moments(self._body, samples)
        drawn = self._body.joints(samples.drawn(N_DRAWN, self._random))
        seen = detected & ~_before_face(found.joints[PART_JOINTS, :2], self._body.head_height)
        answers = hypotheses(self._body, samples, self._random)
        row = {
            "frames": np.int64(frame.number),
            "times": np.float64(frame.time),
            "joints_2d": found.joints[:, :2],
            "joints_2d_covariances": found.joint_covariances[:, :2, :2],
            "joints_3d": found.joints,
            "joints_3d_covariances": found.joint_covariances,
            "angles": found.angles,
            "angle_covariances": found.angle_covariances,
            "samples": drawn.astype(np.float32),
            "hypotheses": answers.weights,
            "hypothesis_joints": answers.joints,
            "seen": seen,
            "stationary": np.bool_(filtered.stationary),
            "missing": np.bool_(frame.missing),
        }
        self.append(frame.number, row)
        self._record.add(frame, found, seen, filtered, answers, answer.evidence, seconds)
        return row

    def __exit__(self, *error: Any) -> None:
        """Complete the file, with what is known when all frames are there."""
        relabelled = self._record.labels.exchanged
        whole = {"exchanged": self._record.exchanged, "relabelled": np.zeros_like(relabelled)}
        self._constants = {**self._constants, **whole}
        super().__exit__(*error)
        if relabelled.any():
            relabel(self._path, self._body, relabelled)


def lengths(body: UpperBody) -> dict[str, float]:
    """Lengths and widths of a body, px, by their names."""
    return {field.name: float(getattr(body, field.name)) for field in fields(body)}


def _before_face(places: Array, head_height: float) -> Mask:
    """`(3,)`: which of the parts at `places` `(3, 2)` px are hands over the head."""
    away = (places - places[0]) / (np.array(FACE_AND_NECK) * head_height)
    return np.asarray((np.hypot(*away.T) < 1) & (np.arange(len(places)) > 0))
