"""The systems of Table 3 on one clip of the face, each as the table has it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.trials.face_baselines import (
    constrained_flow,
    followed,
    generative_template,
    learned_subspace,
    template_subspace,
)
from rsmcm.apps.scenes import face
from rsmcm.chains.face.gflow import GFlow
from rsmcm.models.face.pose import Poses

N_FRAMES = 30
SCENE = face(N_FRAMES, 1, (200, 150), light=0.5)
FRAMES = list(SCENE)


def error(poses: Poses) -> NDArray[np.float64]:
    off = SCENE.model.project(poses) - SCENE.vertices
    return np.asarray(np.linalg.norm(off, axis=2).mean(axis=1))


@pytest.fixture(scope="module")
def flow() -> Poses:
    return constrained_flow(FRAMES, SCENE.model, SCENE.poses[0])


def test_flow_is_one_expert_without_memory(flow: Poses) -> None:
    same = followed(GFlow.optic_flow(SCENE.model, SCENE.poses[0]), FRAMES)
    np.testing.assert_array_equal(flow.translations, same.translations)
    assert len(flow) == N_FRAMES
    assert error(flow).max() < 3


def test_batch_template_holds_where_flow_drifts(flow: Poses) -> None:
    found = generative_template(FRAMES, SCENE.model, flow)
    assert len(found.poses) == len(found.occlusion) == N_FRAMES
    assert error(found.poses).mean() < error(flow).mean()


def test_a_learned_subspace_beats_flow(flow: Poses) -> None:
    known = np.arange(0, N_FRAMES, 3)
    subspace = learned_subspace([FRAMES[number] for number in known], SCENE.model, SCENE.poses[known], 4)
    found = template_subspace(FRAMES, SCENE.model, SCENE.poses[0], subspace)
    assert len(found) == N_FRAMES
    assert error(found).mean() < 0.6 * error(flow).mean()


def test_every_frame_needs_a_picture(flow: Poses) -> None:
    frames = [FRAMES[0], replace(FRAMES[1], image=None)]
    for run in (
        lambda: constrained_flow(frames, SCENE.model, SCENE.poses[0]),
        lambda: generative_template(frames, SCENE.model, flow[:2]),
        lambda: learned_subspace(frames, SCENE.model, SCENE.poses[:2], 1),
    ):
        with pytest.raises(ValueError, match="frame 2: got no picture, expected one in every frame"):
            run()
