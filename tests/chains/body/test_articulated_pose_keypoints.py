"""A generated signer followed with the points of a detector that errs, and without."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.io import with_keypoints
from rsmcm.apps.scenes import SignerScene, signer
from rsmcm.chains import ArticulatedPose, FleshTracker
from rsmcm.chains.body.samples import body_moments
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import BodyParts, Frame
from rsmcm.models.body.upper_body import JOINTS
from scipy.stats import wilcoxon

from ...support.keypoints import read_frame_result

Array = NDArray[np.float64]

SEEDS = tuple(range(1, 9))
ARMS = [JOINTS.index(f"{side}_{name}") for side in ("left", "right") for name in ("elbow", "hand")]


@cache
def scene_of(seed: int, n_frames: int, dropout: float) -> tuple[SignerScene, tuple[Frame, ...]]:
    scene = signer(n_frames, seed, dropout, 0.5, (320, 180))
    return scene, tuple(scene)


@cache
def followed(
    seed: int, n_frames: int = 32, dropout: float = 0.2, **detector: float | tuple[float, float] | None
) -> Array:
    """Head heights `(n_frames, 4)`: errors of elbows and hands in the image; no points without a detector."""
    scene, frames = scene_of(seed, n_frames, dropout)
    body = scene.body
    images = [frame.image for frame in frames if frame.image is not None]
    parts = replace(BodyParts.learned(images, scene.detector), head_height=body.head_height)
    model = MultiChain().connect(FleshTracker(body), parts)
    model.connect(ArticulatedPose(body, 250, start=scene.poses.take([0])), parts)
    given = list(read_frame_result(scene, **detector)) if detector else []  # type: ignore[arg-type]
    known = with_keypoints(frames, lambda frame: given[frame.number - 1]) if given else frames
    errors = []
    for tracked, truth in zip(RecursiveBP(model).run(known), scene.joints, strict=True):
        apart = (body_moments(body, tracked["pose"]).joints - truth)[ARMS, :2]
        errors.append(np.linalg.norm(apart, axis=1) / body.head_height)
    return np.array(errors)[4:]


def gains(**detector: float | tuple[float, float]) -> Array:
    """Head heights, one a scene: mean error without points less that with them."""
    return np.array([(followed(s) - followed(s, **detector)).mean() for s in SEEDS])


def error_of(values: Array) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


@pytest.mark.slow
def test_points_with_errors_misses_and_exchanged_sides_help() -> None:
    """Errors are smaller over the scenes: a rank test, for one scene in eight gains as much as all others."""
    assert wilcoxon(gains(noise=0.08), alternative="greater").pvalue < 0.05


def test_a_detector_without_detections_changes_nothing() -> None:
    # so few frames may have no face at all if some are missed
    alone, without = (followed(SEEDS[0], 8, dropout=0.0, **none) for none in ({}, {"missed": 1.0}))
    np.testing.assert_array_equal(alone, without)
