"""Wrong arguments of trackers of faces and points: one line that names the parameter."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.chains import FeatureMatcher, GFlow, PointTracker
from rsmcm.chains.face.pose_terms import PoseDynamics
from rsmcm.models import (
    MorphableModel,
    PointTracks,
    Poses,
    YuNetFaces,
    frames_of_tracks,
    noise_of_tracks,
)
from rsmcm.models.face.built_in_model import face_model

MODEL = face_model()


def poses(size: float = 30.0, n: int = 1, n_bases: int = MODEL.n_bases) -> Poses:
    return Poses.upright(np.zeros((n, 2)), np.full(n, size), n_bases)


UNKNOWN = Poses(*(np.full(part.shape, np.nan) for part in poses().arrays))


def gflow(start: Any = None, model: Any = MODEL, **settings: Any) -> GFlow:
    return GFlow(model, poses() if start is None else start, **settings)


NO_TRIANGLES = np.zeros((0, 3), np.int64)
WRONG: dict[Callable[..., Any], list[tuple[str, Any]]] = {
    gflow: [
        ("experts", 0), ("experts", "5"), ("gain", 1.5), ("gain", "much"), ("gain", np.nan), ("texels", 0),
        ("temperature", 0.0), ("radius", 0.0), ("effective_pixels", np.inf), ("samples", 2.5),
        ("covariance_scale", -1.0), ("resample_interval", 0.0), ("levels", 4), ("surface", "round"),
        ("tracked", (3, 2)), ("tracked", (10**6,)), ("tracked", ("a",)), ("seed", -1), ("finder", 3),
        ("texture", 4), ("dynamics", 0.5), ("model", "face"), ("start", 5), ("start", poses(n=3)),
        ("start", poses(-1.0)), ("start", UNKNOWN), ("start", poses(n_bases=2)),
    ],
    PoseDynamics: [("rotation", 0.0), ("morphs", -1.0), ("size", np.nan)],
    PointTracker: [
        ("n_points", 0), ("n_points", 3.5), ("spacing", -1.0), ("max_position_std", 0.0),
        ("acceleration", 0.0), ("acceleration", "fast"),
    ],
    FeatureMatcher: [("n_points", 0), ("n_features", 0)],
    PointTracks: [
        ("patch_size", 4), ("patch_size", 1), ("patch_size", "5"), ("noise", 0.0), ("noise", np.nan),
        ("false_alarm_rate", 1.0), ("search_radius", -1.0),
    ],
    YuNetFaces: [("path", "yunet.onnx")],
    lambda **wrong: MorphableModel(**{"bases": np.ones((1, 3, 3)), "triangles": NO_TRIANGLES, **wrong}): [
        ("bases", [[1.0]]), ("triangles", [[0, 1, 2]]), ("landmarks", [1]), ("identity", 0.5),
    ],
    lambda **wrong: frames_of_tracks(**{"tracks": np.zeros((3, 4, 2)), **wrong}): [
        ("tracks", np.zeros((3, 4))), ("tracks", np.full((3, 4, 2), np.inf)), ("tracks", [1, 2]),
        ("rate", 0.0), ("numbers", range(2)),
    ],
    lambda **wrong: Poses(
        **{"rotations": np.eye(3)[None], "translations": np.zeros((1, 2)), "morphs": np.ones((1, 6)), **wrong}
    ): [("rotations", np.eye(3)), ("rotations", [[1.0]])],
    lambda **wrong: Poses.upright(
        **{"translations": np.zeros((2, 2)), "sizes": np.ones(2), "n_bases": 6, **wrong}
    ): [("translations", "here"), ("sizes", np.ones(3)), ("n_bases", 0)],
    MODEL.project: [("poses", None), ("poses", poses(n_bases=2))],
    face_model: [("fineness", 0), ("fineness", "2")],
    noise_of_tracks: [("frames", 3), ("frames", [1]), ("frames", [])],
}  # fmt: skip


@pytest.mark.parametrize(
    ("call", "name", "value"), [(call, *each) for call, rows in WRONG.items() for each in rows]
)
def test_wrong_arguments_are_named_in_one_line(call: Callable[..., Any], name: str, value: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=rf"^{name}\b.*(expected|got)") as caught:
        call(**{name: value})
    assert "\n" not in str(caught.value)


def test_missing_detector_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere.onnx: no such file"):
        YuNetFaces(tmp_path / "nowhere.onnx")
