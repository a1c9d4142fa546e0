"""Coordinate ascent over a film of a body: both chains, whole films, states that are saved."""

import numpy as np
import pytest
from rsmcm.apps.scenes import signer
from rsmcm.chains import ArticulatedPose, FleshTracker
from rsmcm.chains.body.samples import body_moments
from rsmcm.inference import CoordinateAscent, MultiChain
from rsmcm.models import BodyParts
from rsmcm.models.core.frame import Frame


@pytest.fixture(scope="module")
def scene():
    return signer(9, 4, 0.0, 0.3, (320, 180))


@pytest.fixture(scope="module")
def frames(scene):
    images = list(scene.images())
    images[0] = images[6] = None
    return [Frame(image, index * scene.dt, index + 1) for index, image in enumerate(images)]


@pytest.fixture(scope="module")
def engine(scene):
    parts = BodyParts.learned(list(scene.images()), scene.detector)
    pose = ArticulatedPose(scene.body, samples=100, start=scene.poses.take([1]))
    model = MultiChain().connect(FleshTracker(scene.body), parts).connect(pose, parts)
    return CoordinateAscent(model, most_rounds=2, tolerance=None)


@pytest.fixture(scope="module")
def solution(engine, frames):
    return engine.run(frames)


def test_the_body_is_followed(solution, scene):
    trajectory = solution["pose"]
    assert [each is None for each in trajectory.samples] == [True] + 8 * [False]
    assert trajectory.times.shape == trajectory.exchanged.shape == (9,)
    assert np.isfinite(trajectory.log_prior)
    joints = np.array([body_moments(scene.body, each).joints for each in trajectory.samples[1:]])
    errors = np.linalg.norm(joints[:, [0, 4, 7], :2] - scene.joints[1:, [0, 4, 7], :2], axis=2)
    assert np.median(errors) < 0.3 * scene.body.head_height
    assert (trajectory.exchanged < 0.5).all()


def test_chains_speak_of_every_frame(solution):
    for chain in ("flesh", "pose"):
        messages = solution.messages(chain, "parts")
        assert len(messages) == 9
        assert not messages[0].predicted.informative.any()
        assert messages[5].predicted.informative.all()
        assert messages[7].log_mass == pytest.approx(0, abs=1e-6)
