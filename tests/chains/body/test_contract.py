"""Wrong arguments of the body's chains, models and scenes: one line that names the parameter."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.scenes import signer
from rsmcm.chains import ArticulatedPose, BodyDynamics, FixedLag, FleshTracker
from rsmcm.models import BodyParts, Frame, UpperBody

BODY = UpperBody.from_head(90.0)
DYNAMICS = BodyDynamics(BODY)
NO_POSES = DYNAMICS.draw_anywhere(1, (360, 640), np.random.default_rng(0)).take(slice(0))
Call = Callable[[], Any]


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: ArticulatedPose("tall"), "body: "),  # type: ignore[arg-type]
        (lambda: ArticulatedPose(BODY, 9), "samples: got 9, expected 10 or more"),
        (lambda: ArticulatedPose(BODY, 10.5), "samples: "),  # type: ignore[arg-type]
        (lambda: ArticulatedPose(BODY, seed=-1), "seed: got -1, expected 0 or more"),
        (lambda: ArticulatedPose(BODY, start=NO_POSES), "start: "),
        (lambda: ArticulatedPose(BODY, likelihood=3), "likelihood: "),  # type: ignore[arg-type]
        (lambda: ArticulatedPose(BODY).initial(Frame(None, 0.0, 3)), "frame 3: got no image"),
        (lambda: FleshTracker(None), "body: "),  # type: ignore[arg-type]
        (lambda: FleshTracker(BODY, hand_speed=0.0), "hand_speed: got 0.0, expected more than 0"),
        (lambda: FleshTracker(BODY, max_coast_time=np.nan), "max_coast_time: "),
        (lambda: FleshTracker(BODY).initial(Frame(None, 0.0, 3)), "frame 3: got no image"),
        (lambda: BodyDynamics(BODY, place=0.0), "place: got 0.0, expected more than 0"),
        (lambda: BodyDynamics(BODY, jumps=-1.0), "jumps: got -1.0, expected 0 or more"),
        (lambda: BodyDynamics(BODY, lean=np.inf), "lean: "),
        (lambda: FixedLag(DYNAMICS, -1), "lag: got -1, expected 0 or more"),
        (lambda: FixedLag(DYNAMICS, 3, trajectories=1), "trajectories: got 1, expected 2 or more"),
        (lambda: BodyParts(0.0), "head_height: got 0.0, expected more than 0"),
        (lambda: BodyParts(np.nan), "head_height: "),
        (lambda: BodyParts(80.0, bare=2.0), "bare: got 2.0, expected 0 to 1"),
        (lambda: BodyParts(80.0, skin="pale"), "skin: "),  # type: ignore[arg-type]
        (lambda: UpperBody.from_head("tall"), "head_height: "),  # type: ignore[arg-type]
        (lambda: UpperBody.from_head(-3.0), "head_height: got -3.0, expected more than 0"),
        (lambda: UpperBody.fit(np.zeros((3, 7, 2))), "joints: got shape "),
        (lambda: UpperBody.fit("clicked"), "joints: "),  # type: ignore[arg-type]
        (lambda: signer(0), "n_frames: got 0, expected 1 or more"),
        (lambda: signer(2.5), "n_frames: "),  # type: ignore[arg-type]
        (lambda: signer(detector_dropout=1.5), "detector_dropout: got 1.5, expected 0 to 1"),
        (lambda: signer(noise=np.inf), "noise: "),
        (lambda: signer(size=(100, 100)), "size: got "),
        (lambda: signer(sleeves="none"), "sleeves: "),  # type: ignore[arg-type]
    ],
)
def test_a_wrong_argument_is_one_line(call: Call, line: str) -> None:
    with pytest.raises((ValueError, TypeError)) as raised:
        call()
    assert str(raised.value).startswith(line)
    assert "\n" not in str(raised.value)
