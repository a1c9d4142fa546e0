"""What is saved is refused when it is read, where parts do not fit each other or their kind."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps.background.predictions import SAVED as PREDICTIONS
from rsmcm.apps.evaluation.scoring import SAVED as SCORES
from rsmcm.chains.body.flesh_state import Clutter
from rsmcm.chains.face.start import FaceStart
from rsmcm.chains.points.trajectory import Appearances, PointTrajectory
from rsmcm.chains.structure.factor_structure import StructureTrajectory
from rsmcm.chains.structure.recursive_structure import CameraEvidence
from rsmcm.inference.engine import checkpoint
from rsmcm.inference.sfm.factor_analysis.factorisation import Factorisation
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import Poses, SurfacePoints

N, T = 5, 3
IDS = np.arange(N)
APPEARANCES = Appearances(IDS, np.zeros((N, 7, 7), np.float32), np.zeros((N, 7, 7), np.float32), np.zeros(N))
POINTS = PointTrajectory(
    identities=IDS,
    position=np.zeros((T, N, 2)),
    covariance=np.zeros((T, N, 2, 2)),
    observed=np.ones((T, N), np.bool_),
    alive=np.ones((T, N), np.bool_),
    information=np.zeros((T, N, 2, 2)),
    vector=np.zeros((T, N, 2)),
    appearances=APPEARANCES,
    absorbed=np.zeros((0, 2), np.int64),
    log_prior=0.0,
)
FACTORISATION = Factorisation(
    cameras=np.zeros((T, 2, 4)),
    camera_covariance=np.zeros((T, 4, 4)),
    shape=np.zeros((N, 3)),
    shape_covariance=np.zeros((N, 3, 3)),
    noise_variance=1.0,
    rmse=1.0,
    coherent=True,
    motion_noise=np.zeros((2, 2)),
    frame_determined=np.ones(T, np.bool_),
    history=(),
)
SHAPE = StructureTrajectory(IDS, IDS, FACTORISATION, 1.0, 1.0, np.ones((T, N), np.bool_))
EVIDENCE = CameraEvidence(information=np.zeros((T, 4, 4)), vector=np.zeros((T, 2, 4)), times=np.arange(3.0))
CLUTTER = Clutter(np.zeros((2, N, 2)), np.ones((2, N)), np.full((2, N), 0.5))
MODEL = face_model()
START = FaceStart(
    MODEL,
    Poses.upright(np.zeros((1, 2)), np.ones(1), MODEL.n_bases),
    SurfacePoints(np.zeros((1, 3), np.int64), np.full((1, 3), 1 / 3), np.zeros((1, 3))),
    np.ones(1, np.bool_),
    None,
)


@pytest.mark.parametrize("value", [POINTS, SHAPE, EVIDENCE, CLUTTER, START])
def test_what_fits_is_read(value: Any, tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "x.npz", {"x": value}, {"x": type(value)})
    checkpoint.load(tmp_path / "x.npz", {"x": type(value)})


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (replace(POINTS, position=POINTS.position[:, 1:]), r"x/position: got shape \(3, 4, 2\), expected"),
        (replace(POINTS, observed=POINTS.observed[0]), r"x/observed: got shape \(5,\), expected"),
        (replace(POINTS, alive=POINTS.alive[1:]), r"x/alive: got shape \(2, 5\)"),
        (replace(POINTS, vector=POINTS.vector + np.nan), "x/vector: got NaN"),
        (replace(POINTS, information=np.zeros(())), r"x/information: got shape \(\), expected"),
        (replace(POINTS, absorbed=IDS), r"x/absorbed: got shape \(5,\), expected"),
        (
            replace(POINTS, appearances=replace(APPEARANCES, cut=np.zeros(N - 1))),
            "appearances/cut: got shape",
        ),
        (replace(SHAPE, point_of_track=IDS + 1), "x: point_of_track: got other numbers, expected -1 to 4"),
        (replace(SHAPE, point_of_track=IDS - 2), "x: point_of_track: got other numbers"),
        (replace(SHAPE, trusted=SHAPE.trusted[1:]), "x: factorisation: got 3 cameras, expected 2"),
        (
            replace(SHAPE, factorisation=replace(FACTORISATION, shape=np.zeros((N, 2)))),
            r"factorisation/shape: got shape \(5, 2\), expected",
        ),
        (replace(EVIDENCE, times=np.zeros(T)), "x: times: got numbers that do not increase"),
        (replace(CLUTTER, existence=CLUTTER.existence + 1), "x/existence: got .*, expected probabilities"),
        (replace(CLUTTER, variances=-CLUTTER.variances), "x/variances: got .*, expected numbers above 0"),
        (
            replace(START, model=replace(MODEL, bases=2 * MODEL.bases)),
            "typical shape of radius 2, expected 1",
        ),
    ],
)
def test_what_does_not_fit_is_refused(value: Any, message: str, tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "x.npz", {"x": value}, {"x": type(value)})
    with pytest.raises(ValueError, match=rf"x\.npz: .*{message}"):
        checkpoint.load(tmp_path / "x.npz", {"x": type(value)})


PIXELS = {"rows": [[1, [0.1, 0.2, 0.3]]], "every": 0.4, "last": None}
BOXES = {"every": 1, "offered": 0, "frames": []}
ERRORS = {"frames": [1], "pixels": [[1], [[1, 2, 3, 4]]]}


@pytest.mark.parametrize(
    ("kinds", "value", "message"),
    [
        (PREDICTIONS, {"pixels": {**PIXELS, "rows": [["inf", [0.1, 0.2, 0.3]]]}, "boxes": BOXES}, "rows/0/0"),
        (PREDICTIONS, {"pixels": {**PIXELS, "rows": [[1, [0.1]]]}, "boxes": BOXES}, "rows/0/1: got"),
        (PREDICTIONS, {"pixels": PIXELS, "boxes": {**BOXES, "every": None}}, "boxes/every: got"),
        (SCORES, {**ERRORS, "errors": {"ghosts": []}}, "errors: got ghosts, expected"),
        (SCORES, {**ERRORS, "pixels": [[1], [[1, 2, 3]]], "errors": None}, "pixels/1/0: got"),
    ],
)
def test_plain_values_of_another_kind_are_refused(
    kinds: Any, value: Any, message: str, tmp_path: Path
) -> None:
    checkpoint.save(tmp_path / "x.npz", {"x": value}, {"x": Any})
    with pytest.raises(ValueError, match=rf"x\.npz: x/.*{message}"):
        checkpoint.load(tmp_path / "x.npz", {"x": kinds})
