"""Results in which left and right hand have changed their names, as a whole film says that they should."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import ANGLES, JOINTS, UpperBody, arm_at, shoulder_rotations, swivels
from ...models.numerics.rotations import logarithm
from .samples import weighted_moments

Array = NDArray[np.float64]
Row = Mapping[str, NDArray[Any]]

SHOULDERS, ELBOWS, HANDS = (
    [JOINTS.index(f"{side}_{name}") for side in ("left", "right")] for name in ("shoulder", "elbow", "hand")
)
OF_ARMS = slice(ANGLES - 8, ANGLES)
ROWS = {
    "joints_2d", "joints_2d_covariances", "joints_3d", "joints_3d_covariances", "angles", "angle_covariances",
    "samples", "hypotheses", "hypothesis_joints", "seen", "relabelled",
}  # fmt: skip
EXCHANGED_PARTS = [0, 2, 1]


def with_names_exchanged(body: UpperBody, row: Row) -> dict[str, NDArray[Any]]:
    """A row of `poses.npz` with each hand where the other one was.

    Arms lead there with their elbows turned as they were; one that is too short ends on its way. Elbows and
    angles of arms are then those of the poses that were drawn, whose arms no longer say anything of the rest.
    """
    samples, arms = _exchanged(body, row["samples"].astype(np.float64))
    others, _ = _exchanged(body, row["hypothesis_joints"])
    joints, covariances = row["joints_3d"].copy(), row["joints_3d_covariances"].copy()
    joints[HANDS], covariances[HANDS] = joints[HANDS[::-1]], covariances[HANDS[::-1]]
    even = np.full(len(samples), 1 / len(samples))
    joints[ELBOWS], covariances[ELBOWS] = weighted_moments(samples[:, ELBOWS], even)
    rotations, flexions = shoulder_rotations(arms)
    turns = logarithm(rotations.reshape(-1, 3, 3)).reshape(len(arms), 2, 3)
    of_arms = np.concatenate([turns, flexions[..., None]], axis=2).reshape(len(arms), -1)
    angles, angle_covariances = row["angles"].copy(), row["angle_covariances"].copy()
    angles[OF_ARMS] = of_arms.mean(axis=0)
    angle_covariances[OF_ARMS] = angle_covariances[:, OF_ARMS] = 0
    angle_covariances[OF_ARMS, OF_ARMS] = np.cov(of_arms, rowvar=False, bias=True)
    return {
        **row,
        "joints_2d": joints[:, :2],
        "joints_2d_covariances": covariances[:, :2, :2],
        "joints_3d": joints,
        "joints_3d_covariances": covariances,
        "angles": angles,
        "angle_covariances": angle_covariances,
        "samples": samples.astype(np.float32),
        "hypothesis_joints": others,
        "seen": row["seen"][EXCHANGED_PARTS],
        "relabelled": ~row["relabelled"],
    }


def relabelled(
    body: UpperBody, poses: Mapping[str, NDArray[Any]], exchanged: NDArray[np.bool_]
) -> dict[str, NDArray[Any]]:
    """Columns of `poses.npz` with the names exchanged in these rows `(n,)`, and `relabelled`, which are."""
    columns = {**poses, "relabelled": np.zeros(len(exchanged), np.bool_)}
    if exchanged.any():
        columns |= {name: columns[name].copy() for name in ROWS}
    for index in np.flatnonzero(exchanged).tolist():
        row = with_names_exchanged(body, {name: columns[name][index] for name in ROWS})
        for name in ROWS:
            columns[name][index] = row[name]
    return columns


def _exchanged(body: UpperBody, joints: Array) -> tuple[Array, Array]:
    """Joints `(n, 8, 3)` px with exchanged hands, and arms `(n, 2, 2, 3)` that lead there."""
    joints, hands = joints.copy(), joints[:, HANDS[::-1]]
    lengths = np.array([body.upper_arm, body.forearm])
    arms = np.full((len(joints), 2, 2, 3), np.nan)
    there = np.isfinite(hands).all(axis=(1, 2))
    for side in (0, 1):
        shoulder, elbow, hand = (joints[there, each[side]] for each in (SHOULDERS, ELBOWS, HANDS))
        before = np.stack([elbow - shoulder, hand - elbow], axis=1) / lengths[:, None]
        arms[there, side] = arm_at(body, side, hands[there, side] - shoulder, swivels(side, before, body))[0]
        steps = np.cumsum(lengths[:, None] * arms[:, side], axis=1)
        for joint, step in ((ELBOWS[side], 0), (HANDS[side], 1)):
            joints[:, joint] = joints[:, SHOULDERS[side]] + steps[:, step]
    return joints, arms
