"""A generated signer followed with the points of a detector that errs, and without."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.io import with_keypoints
from rsmcm.apps.scenes import SignerScene, signer
from rsmcm.chains import ArticulatedPose, FleshTracker
from rsmcm.chains.body.samples import body_moments
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import BodyParts, Frame
from rsmcm.models.body.upper_body import JOINTS
from rsmcm.models.core.gaussian_message import squared_distances

from ...support.keypoints import found_in

Array = NDArray[np.float64]

SEEDS = (1, 2)
ARMS = [JOINTS.index(f"{side}_{name}") for side in ("left", "right") for name in ("elbow", "hand")]
REGION_90 = 4.605


@dataclass(frozen=True, eq=False)
class Followed:
    """Head heights, `(n_frames, 4)`: how far elbows and hands are off in the picture, and their depth; and
    `(n_frames, 4)` squared Mahalanobis distances in the picture.
    """

    flat: Array
    deep: Array
    nees: Array


@cache
def scene_of(seed: int) -> tuple[SignerScene, tuple[Frame, ...]]:
    scene = signer(32, seed, 0.2, 0.5, (320, 180))
    return scene, tuple(scene)


@cache
def followed(seed: int, **detector: float | tuple[float, float] | None) -> Followed:
    """How a scene is followed; `None` as noise is no detector of keypoints."""
    scene, frames = scene_of(seed)
    body = scene.body
    images = [frame.image for frame in frames if frame.image is not None]
    parts = replace(BodyParts.learned(images, scene.detector), head_height=body.head_height)
    model = MultiChain().connect(FleshTracker(body), parts)
    model.connect(ArticulatedPose(body, 250, start=scene.poses.take([0])), parts)
    given = list(found_in(scene, **detector)) if detector else []  # type: ignore[arg-type]
    known = with_keypoints(frames, lambda frame: given[frame.number - 1]) if given else frames
    flat, deep, nees = [], [], []
    for tracked, truth in zip(RecursiveBP(model).run(known), scene.joints, strict=True):
        found = body_moments(body, tracked["pose"])
        apart = (found.joints - truth)[ARMS]
        flat.append(np.linalg.norm(apart[:, :2], axis=1) / body.head_height)
        deep.append(np.abs(apart[:, 2]) / body.head_height)
        nees.append(squared_distances(apart[:, :2], found.joint_covariances[ARMS, :2, :2] + 0.01 * np.eye(2)))
    return Followed(np.array(flat)[4:], np.array(deep)[4:], np.array(nees)[4:])


def all_scenes(**detector: float | tuple[float, float]) -> Followed:
    runs = [followed(seed, **detector) for seed in SEEDS]
    return Followed(*(np.stack([getattr(run, name) for run in runs]) for name in ("flat", "deep", "nees")))


def test_points_with_errors_misses_and_exchanged_sides_help() -> None:
    """Error falls by a fifth and more, and regions hold about as much as they did."""
    alone, helped = all_scenes(), all_scenes(noise=0.08)
    assert helped.flat.mean() < 0.8 * alone.flat.mean()
    assert helped.flat.mean() < 0.15
    inside = [(each.nees < REGION_90).mean() for each in (alone, helped)]
    assert inside[1] > inside[0] - 0.08  # neighbouring frames err together: few are independent
    assert helped.deep.mean() < 0.5


def test_sides_that_are_often_exchanged_do_no_harm() -> None:
    assert all_scenes(exchanged=0.3).flat.mean() < all_scenes().flat.mean()


def test_points_of_another_person_do_not_pull() -> None:
    """Who is beside this one, or half hidden by him, is somebody else."""
    alone = all_scenes()
    unit = scene_of(SEEDS[0])[0].body.head_height
    for shift in ((3 * unit, 0.0), (-0.9 * unit, 0.5 * unit)):
        assert all_scenes(shift=shift).flat.mean() < alone.flat.mean() + 0.05


def test_a_detector_that_finds_nobody_changes_nothing() -> None:
    alone, nobody = followed(SEEDS[0]), followed(SEEDS[0], missed=1.0)
    np.testing.assert_array_equal(alone.flat, nobody.flat)
