"""Hands that change their names in what a run has written."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.body.dynamics import BodyDynamics
from rsmcm.chains.body.hand_labelling import ELBOWS, HANDS, ROWS, SHOULDERS, exchange_hands, relabel_hands
from rsmcm.chains.body.samples import BodySamples, body_moments
from rsmcm.models.body.upper_body import UpperBody

from ...support.body_poses import resting

N_DRAWN = 40

BODY = UpperBody.from_head(60.0)
TRUNK = [0, 1, *SHOULDERS]


@pytest.fixture(scope="module")
def row() -> dict[str, NDArray[Any]]:
    """About a pose whose hands can both be where the other one is."""
    random = np.random.default_rng(0)
    around = resting(np.tile([300.0, 150.0], (N_DRAWN, 1)))
    around.arms[:, :, 1] = np.array([[-0.6, 0.3, -0.75], [0.5, 0.1, -0.86]])
    poses = BodyDynamics(BODY, jumps=0).draw(around, 0.01, random)
    samples = BodySamples.even(poses, (360, 640), random)
    found, joints = body_moments(BODY, samples), BODY.joints(poses)
    return {
        "joints_2d": found.joints[:, :2],
        "joints_2d_covariances": found.joint_covariances[:, :2, :2],
        "joints_3d": found.joints,
        "joints_3d_covariances": found.joint_covariances,
        "angles": found.angles,
        "angle_covariances": found.angle_covariances,
        "samples": joints,
        "hypotheses": np.array([0.7, 0.3, 0, 0]),
        "hypothesis_joints": np.stack([*joints[:2], *np.full((2, 8, 3), np.nan)]),
        "seen": np.array([True, True, False]),
        "seen_probability": np.array([0.9, 0.8, 0.1]),
        "relabelled": np.bool_(False),
    }


def test_hands_change_places_and_arms_lead_there(row: dict[str, NDArray[Any]]) -> None:
    found = exchange_hands(BODY, row)
    for name in ("samples", "hypothesis_joints", "joints_3d"):
        before, after = row[name], found[name]
        np.testing.assert_allclose(after[..., TRUNK, :], before[..., TRUNK, :])
        np.testing.assert_allclose(after[..., HANDS, :], before[..., HANDS[::-1], :], atol=1e-4)
    for name in ("samples", "hypothesis_joints"):
        joints = found[name][:2]
        for ends, length in (((SHOULDERS, ELBOWS), BODY.upper_arm), ((ELBOWS, HANDS), BODY.forearm)):
            steps = joints[:, ends[1]] - joints[:, ends[0]]
            np.testing.assert_allclose(np.linalg.norm(steps, axis=2), length, rtol=1e-5)
    assert np.isnan(found["hypothesis_joints"][2:]).all()
    np.testing.assert_allclose(found["joints_3d"][ELBOWS], found["samples"].mean(axis=0)[ELBOWS], atol=1e-3)
    assert found["seen"].tolist() == [True, False, True]
    assert found["seen_probability"].tolist() == [0.9, 0.1, 0.8]
    assert found["relabelled"]
    assert np.linalg.eigvalsh(found["angle_covariances"]).min() > -1e-9
    np.testing.assert_array_equal(found["angles"][:8], row["angles"][:8])


def test_some_rows_of_all(row: dict[str, NDArray[Any]]) -> None:
    """Others and other columns stay."""
    n = 8
    columns = {name: np.stack([each] * n) for name, each in row.items() if name != "relabelled"}
    before = {name: each.copy() for name, each in columns.items()}
    chosen = np.arange(n) % 3 == 1
    found = relabel_hands(BODY, {**columns, "missing": np.arange(n)}, chosen)
    assert found["missing"].tolist() == list(range(n))
    np.testing.assert_array_equal(found["relabelled"], chosen)
    exchanged = exchange_hands(BODY, row)
    for name in ROWS - {"relabelled"}:
        for index in range(n):
            expected = exchanged if chosen[index] else row
            np.testing.assert_array_equal(found[name][index], expected[name], err_msg=name)
        np.testing.assert_array_equal(columns[name], before[name])
