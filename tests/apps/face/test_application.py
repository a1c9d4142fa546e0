"""`rsmcm face`, as a user runs it: on rendered films of a face, and with what can be wrong about them."""

import signal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.face import application
from rsmcm.apps.face.application import run_face
from rsmcm.apps.face.job import FaceJob
from rsmcm.apps.face.page import FaceRecord, angles
from rsmcm.apps.runs.interruption import Interrupted
from rsmcm.apps.scenes import face
from rsmcm.chains.face.recovery import WIDTH_OF_FACE
from rsmcm.chains.face.start import start_from_box, start_from_landmarks
from rsmcm.models import Frame
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.detectors import PartDetector
from rsmcm.models.face.model_files import write_model
from rsmcm.models.face.morphable_model import MorphableModel, Poses
from rsmcm.models.numerics.rotations import exponential

from ...conftest import Command, names, summary_of
from ...support.records import log_of

run = Command("face")
complaint = run.complaint

RESULTS = {
    "film.mp4",
    "view.npz",
    "view.html",
    "poses.npz",
    "texture.png",
    "texture_variance.png",
    "summary.json",
    "state.npz",
    "manifest.json",
}
N_FRAMES = 16
SIZE = (200, 160)
FEW = ("--experts", "4")


def poses_of(out: Path) -> dict[str, NDArray[Any]]:
    with np.load(out / "poses.npz", allow_pickle=False) as content:
        return dict(content)


def saved(path: Path, array: Any) -> Path:
    np.save(path, array)
    return path


def write_pictures(folder: Path, images: list[NDArray[np.uint8]]) -> Path:
    folder.mkdir()
    for number, image in enumerate(images, start=1):
        cv2.imwrite(str(folder / f"frame{number}.png"), image)
    return folder


@pytest.fixture(scope="module")
def scene() -> Any:
    return face(N_FRAMES, 3, SIZE)


@pytest.fixture(scope="module")
def images(scene: Any) -> list[NDArray[np.uint8]]:
    return list(scene.images())


@pytest.fixture(scope="module")
def film(images: list[NDArray[np.uint8]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pictures(tmp_path_factory.mktemp("film") / "film", images)


@pytest.fixture(scope="module")
def truth(scene: Any, film: Path) -> Path:
    """Landmarks of all frames: the vertices of the built-in model, in its order."""
    return saved(film.parent / "truth.npy", scene.vertices.astype(np.float32))


@pytest.fixture(scope="module")
def start(scene: Any, film: Path) -> Path:
    """Landmarks of the first frame only."""
    return saved(film.parent / "start.npy", scene.vertices[0])


@pytest.fixture(scope="module")
def finished(film: Path, truth: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "deep" / "er"
    assert run(film, "--landmarks", truth, "--out", out) == 0
    return out


# --- results ------------------------------------------------------------------------------------------------


def test_results(finished: Path) -> None:
    assert names(finished) == RESULTS
    summary = summary_of(finished)
    assert (summary["frames"], summary["first_frame"], summary["last_frame"]) == (N_FRAMES, 1, N_FRAMES)
    assert summary["start"] == "landmarks"
    assert summary["start_fit_error_px"] < 0.5
    assert (summary["lost_frames"], summary["lost"], summary["reinitialised"]) == (0, [], [])
    assert not summary["ended_early"]
    # some faces have little texture, which looks like a poor start
    assert all(note.startswith("The start may be poor") for note in summary["notes"])
    assert summary["parameters"]["experts"] == 20
    assert summary["error"]["frames"] == N_FRAMES
    assert summary["error"]["mean_px"] < 0.6
    assert summary["log_evidence"]["lowest"] <= summary["log_evidence"]["median"] < 0
    assert summary["log_evidence"]["lowest_frame"] > 1


def test_poses(finished: Path, scene: Any) -> None:
    poses = poses_of(finished)
    n, experts = N_FRAMES, 20
    nv, k = scene.model.n_vertices, scene.model.n_bases
    shapes = {
        "frame_numbers": (n,), "times": (n,), "weights": (n, experts), "rotations": (n, experts, 3, 3),
        "translations": (n, experts, 2), "morphs": (n, experts, k), "mean_rotation": (n, 3, 3),
        "mean_translation": (n, 2), "mean_morphs": (n, k),
        "vertices_2d": (n, nv, 2), "vertices_3d": (n, nv, 3),
        "covariance": (n, nv, 3, 3), "landmarks": (n, nv, 2), "log_evidence": (n,), "fit": (n,), "lost": (n,),
        "tracked_probability": (n,),
        "reinitialised": (n,), "missing": (n,), "bases": (k, nv, 3), "triangles": scene.model.triangles.shape,
    }  # fmt: skip
    assert {name: array.shape for name, array in poses.items()} == shapes
    assert poses["frame_numbers"].tolist() == list(range(1, n + 1))
    np.testing.assert_allclose(poses["times"], np.arange(n) / 25)
    np.testing.assert_allclose(poses["weights"].sum(axis=1), 1)
    assert np.isnan(poses["log_evidence"]).tolist() == [True] + [False] * (n - 1)
    np.testing.assert_array_equal(poses["vertices_2d"], poses["vertices_3d"][..., :2])
    assert np.linalg.eigvalsh(poses["covariance"].astype(float)).min() > -1e-4
    np.testing.assert_allclose(poses["landmarks"][0], scene.vertices[0], atol=1e-3)
    for what in ("landmarks", "vertices_2d"):
        error = np.linalg.norm(poses[what] - scene.vertices, axis=2)
        assert error.mean() < 0.6, what
    turns = poses["mean_rotation"] @ np.swapaxes(scene.poses.rotations, 1, 2)
    off = np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert off.mean() < 2.5


def test_poses_say_where_vertices_are(finished: Path) -> None:
    poses = poses_of(finished)
    model = MorphableModel(poses["bases"], poses["triangles"])
    for frame in (0, 7, N_FRAMES - 1):
        experts = Poses(poses["rotations"][frame], poses["translations"][frame], poses["morphs"][frame])
        places = model.positions(experts)
        mean = np.tensordot(poses["weights"][frame], places, 1)
        np.testing.assert_allclose(poses["vertices_3d"][frame], mean, atol=1e-3)
        off = places - mean
        spread = np.einsum("n,nva,nvb->vab", poses["weights"][frame], off, off)
        left_open = np.linalg.eigvalsh(poses["covariance"][frame] - spread)
        assert (left_open > -1e-3).all()
        assert (left_open[:, -1] > 1e-3).all() == (frame > 0)


# --- landmarks ----------------------------------------------------------------------------------------------


def test_landmarks_in_another_order_of_which_some_are_missing(film: Path, scene: Any, tmp_path: Path) -> None:
    """Some of the vertices, shuffled, a point that the model does not know, and a frame without any.

    As many rows as the source has frames count from its beginning.
    """
    chosen = np.random.default_rng(0).permutation(scene.model.n_vertices)[:30]
    unknown = scene.vertices[:, chosen[:1]] + (3.0, 2.0)
    landmarks = np.concatenate([unknown, scene.vertices[:, chosen]], axis=1)
    landmarks[4, 3:6] = np.nan
    landmarks[6] = np.nan
    pairs = tmp_path / "pairs.txt"
    lines = [f"{index} = {vertex + 1}  # a comment" for index, vertex in enumerate(chosen, start=1)]
    pairs.write_text("\n".join(["# landmarks", *lines]))
    given, out = saved(tmp_path / "l.npy", landmarks), tmp_path / "out"
    options = ("--landmarks", given, "--correspondences", pairs, "--start", 5, "--stop", 11, "--step", 2)
    assert run(film, *options, "--out", out, *FEW) == 0
    found = poses_of(out)["landmarks"]
    assert found.shape == (4, 31, 2)
    assert np.flatnonzero(np.isnan(found[:, :, 0]).all(axis=0)).tolist() == [3, 4, 5]
    np.testing.assert_allclose(found[0, 6:], landmarks[4, 6:], atol=1e-3)
    assert summary_of(out)["error"]["frames"] == 3
    assert summary_of(out)["error"]["mean_px"] < 1


# --- hard input ---------------------------------------------------------------------------------------------


def test_missing_and_blank_frames(images: list[NDArray[np.uint8]], truth: Path, tmp_path: Path) -> None:
    changed = list(images)
    changed[6], changed[9] = np.zeros_like(images[0]), np.full_like(images[0], 255)
    folder = write_pictures(tmp_path / "film", changed)
    unreadable = folder / "frame4.png"
    unreadable.write_bytes(unreadable.read_bytes()[:60])
    out = tmp_path / "out"
    assert run(folder, "--landmarks", truth, "--out", out, *FEW) == 0
    summary, poses = summary_of(out), poses_of(out)
    assert summary["missing"] == [4, 7, 10]
    assert summary["blank"] == [7, 10]
    assert np.flatnonzero(poses["missing"]).tolist() == [3, 6, 9]
    assert np.isnan(poses["log_evidence"][[0, 3, 6, 9]]).all()
    assert np.isfinite(poses["vertices_3d"]).all()
    assert summary["error"]["mean_px"] < 1.5
    assert any("frames 4, 7, 10" in note for note in summary["notes"])
    video = cv2.VideoCapture(str(out / "film.mp4"))
    assert sum(iter(lambda: video.read()[0], False)) == N_FRAMES


def test_wrong_arguments(
    film: Path, start: Path, scene: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = ("--out", tmp_path / "out")
    vertices = scene.vertices[0]
    text = tmp_path / "model.npz"
    text.write_text("a face")
    flat = tmp_path / "flat.npz"
    write_model(MorphableModel(scene.model.bases, np.zeros((0, 3), np.int64)), flat)
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("0 = 400\n")
    far = tmp_path / "far.txt"
    far.write_text("900 = 4\n")
    nonsense = tmp_path / "nonsense.txt"
    nonsense.write_text("0 = 4\nzero = 1\n")

    def landmarks(name: str, array: Any) -> tuple[str, Path]:
        return "--landmarks", saved(tmp_path / f"{name}.npy", array)

    for arguments, words in (
        ((film, *out, "--landmarks", tmp_path / "nowhere.npy"), "nowhere.npy: No such file"),
        ((film, *out, *landmarks("few", vertices[:7])), "got 7, but the model has"),
        ((film, *out, *landmarks("nan", vertices * np.nan)), "got NaN for all in the first frame"),
        ((film, *out, *landmarks("big", vertices * 4)), "outside the picture of 200x160 px"),
        (
            (film, *out, *landmarks("half", np.where(np.arange(2) == 0, np.nan, vertices))),
            "expected both coordinates",
        ),
        (
            (
                film,
                *out,
                *landmarks("three", np.where(np.arange(len(vertices))[:, None] < 3, vertices, np.nan)),
            ),
            "expected 4 or more",
        ),
        ((film, *out, *landmarks("point", np.full_like(vertices, 50.0))), "at one place"),
        ((film, *out, "--correspondences", pairs), "without landmarks"),
        ((film, *out, "--landmarks", start, "--correspondences", pairs), "got vertex 400, expected 1 to"),
        ((film, *out, "--landmarks", start, "--correspondences", far), "got landmark 900, expected 0 to"),
        ((film, *out, "--landmarks", start, "--correspondences", nonsense), "nonsense.txt, line 2"),
        ((film, *out, "--landmarks", start, "--model", tmp_path / "no.npz"), "no.npz"),
        ((film, *out, "--landmarks", start, "--model", text), "model.npz"),
        ((film, *out, "--landmarks", start, "--model", flat), "without triangles"),
        ((film, *out, "--landmarks", start, "--experts", 0), "--experts: got 0"),
        ((film, *out, "--landmarks", start, "--gain", 1.5), "--gain: got 1.5"),
        ((film, *out, "--landmarks", start, "--gain", "nan"), "--gain: got nan"),
        ((film, *out, "--landmarks", start, "--gain", "quick"), "--gain"),
        ((film, *out, "--landmarks", start, "--start", 99), "start: got 99"),
        ((tmp_path / "nowhere", *out, "--landmarks", start), "no such file or folder"),
        ((film, "--landmarks", start), "--out is needed"),
    ):
        assert words in complaint(capfd, *arguments), arguments
        assert not (tmp_path / "out").exists()


# --- without landmarks --------------------------------------------------------------------------------------


def box_of(scene: Any, index: int) -> tuple[float, float, float, float]:
    low, high = scene.vertices[index].min(axis=0), scene.vertices[index].max(axis=0)
    wide = (high - low)[0] / WIDTH_OF_FACE
    return (
        float((low + high)[0] / 2 - wide / 2),
        float((low + high)[1] / 2 - wide / 2),
        float(wide),
        float(wide),
    )


def test_started_by_a_detector(
    film: Path, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The track starts with the first of three frames that show a face in one place, as a typical shape.

    The detector errs in the first frame, and finds nothing in the second one.
    """
    loaded = []

    def detect(frame: Frame) -> NDArray[np.float64]:
        boxes = {1: (0.0, 0.0, 20.0, 20.0), **{k + 1: box_of(scene, k) for k in range(2, 5)}}
        return np.array([boxes[frame.number]] if frame.number in boxes else np.zeros((0, 4)))

    def load(*_: object) -> PartDetector:
        loaded.append(True)
        return detect

    monkeypatch.setattr(application, "default_faces", load)
    out = tmp_path / "out"
    assert run(film, "--out", out, *FEW) == 0
    summary, poses = summary_of(out), poses_of(out)
    assert summary["start"] == "face detector"
    assert len(loaded) == 1
    assert (summary["before_the_start"], summary["first_frame"]) == ([1, 2], 3)
    assert poses["landmarks"].shape == (N_FRAMES - 2, 0, 2)
    assert summary["error"] is None
    assert np.linalg.norm(poses["vertices_2d"] - scene.vertices[2:], axis=2).mean() < 4


@pytest.mark.parametrize("after", [1, 2])
def test_interrupted_before_a_face_is_sure(
    after: int, film: Path, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def detect(frame: Frame) -> NDArray[np.float64]:
        if frame.number == after:
            signal.raise_signal(signal.SIGINT)
        return np.array([box_of(scene, frame.number - 1)])

    monkeypatch.setattr(application, "default_faces", lambda *_: detect)
    with pytest.raises(Interrupted, match="before there was any result"):
        run_face(FaceJob(str(film), out=tmp_path / "out", experts=4))
    assert not (tmp_path / "out" / "poses.npz").exists()


def test_no_face_and_no_detector(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"no network")
    out = ("--out", tmp_path / "out")
    assert "bad.onnx: is no model" in complaint(capfd, film, *out, "--detector", bad)
    assert "nowhere.onnx: no such file" in complaint(
        capfd, film, *out, "--detector", tmp_path / "nowhere.onnx"
    )
    monkeypatch.delattr(cv2, "CascadeClassifier", raising=False)
    message = complaint(capfd, film, *out)
    assert "no face detector, expected --landmarks" in message
    monkeypatch.setattr(application, "default_faces", lambda *_: lambda frame: np.zeros((0, 4)))
    assert "no face is found in it" in complaint(capfd, film, *out)
    assert not (tmp_path / "out").exists()


FACE_ROW = {
    "weights": np.full(4, 0.25),
    "mean_rotation": np.eye(3),
    "mean_morphs": np.ones(2),
    "log_evidence": -1.0,
    "fit": 0.9,
    "error": np.nan,
    "lost": np.bool_(False),
    "tracked_probability": 0.9,
    "reinitialised": np.bool_(False),
}
"""What a record takes of a frame."""


def test_a_poor_start_is_said() -> None:
    """By its fit in the first second, and by landmarks that the model does not meet."""
    for fits, poor in ((0.97, False), (0.8, True)):
        shown = [np.nan if number == 1 else fits if number <= 26 else 0.5 for number in range(1, 61)]
        record = FaceRecord(log_of([{**FACE_ROW, "fit": fit} for fit in shown]))
        assert record.start_fit == pytest.approx(fits)
        assert any("start may be poor" in note for note in record.notes) == poor
    model = face_model()
    pose = Poses.upright(np.array([[100.0, 80.0]]), np.array([30.0]), model.n_bases)
    true = model.project(pose)[0]
    assert start_from_landmarks(model, true).misfit is None
    mixed = np.random.default_rng(0).permutation(true)
    assert "misses the landmarks" in (start_from_landmarks(model, mixed).misfit or "")


def test_a_typical_shape_fills_the_box() -> None:
    model = face_model()
    begun = start_from_box(model, (40.0, 30.0, 100.0, 120.0))
    places = begun.model.project(begun.pose)[0]
    low, high = places.min(axis=0), places.max(axis=0)
    np.testing.assert_allclose((low + high) / 2, (90, 90))
    assert (high - low)[0] == pytest.approx(100 * WIDTH_OF_FACE)
    with pytest.raises(ValueError, match="box: got"):
        start_from_box(model, (40.0, 30.0, 0.0, 10.0))


def test_a_start_meets_all_landmarks() -> None:
    """Also those that the model does not know, and whoever it is."""
    model = face_model()
    model = MorphableModel(model.bases, model.triangles, identity=2)
    random = np.random.default_rng(5)
    pose = Poses.upright(np.array([[100.0, 80.0]]), np.array([30.0]), model.n_bases)
    pose = pose.moved(
        np.concatenate([0.2 * random.normal(size=3), np.zeros(3), 9 * random.normal(size=model.n_bases - 1)])[
            None
        ]
    )
    landmarks = model.project(pose)[0] + 0.2 * random.normal(size=(model.n_vertices, 2))
    landmarks[3] = np.nan
    landmarks = np.concatenate([landmarks, [[4.0, 5.0]]])
    pairs = np.stack([np.arange(model.n_vertices), np.arange(1, model.n_vertices + 1)], axis=1)
    begun = start_from_landmarks(model, landmarks, pairs)
    assert begun.model.n_bases == model.n_bases - 2
    assert begun.fit_error is not None
    assert begun.fit_error < 0.5
    assert np.flatnonzero(~begun.present).tolist() == [3]
    places = begun.points.project(begun.model, begun.pose)[0]
    np.testing.assert_allclose(places, landmarks[begun.present], atol=1e-6)


# --- record -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "number"), [(1, 0), (0, 1), (2, 2)])
def test_angles(axis: int, number: int) -> None:
    """Each by itself, in the direction that its name says."""
    vector = np.zeros((1, 3))
    vector[0, axis] = 0.3
    rotation = exponential(vector)[0]
    expected = np.zeros(3)
    expected[number] = np.degrees(0.3)
    np.testing.assert_allclose(angles(rotation), expected, atol=1e-9)
    gaze, up = rotation @ (0, 0, -1), rotation @ (0, -1, 0)
    assert (gaze[0] < 0, gaze[1] > 0, up[0] > 0)[number], "to the left, down, clockwise"


def test_a_record_of_any_length() -> None:
    rows = [
        {
            **FACE_ROW,
            "log_evidence": -float(number),
            "lost": np.bool_(number in (5, 6, 7, 20, 100)),
            "reinitialised": np.bool_(number == 8),
            "missing": np.bool_(number == 9),
        }
        for number in range(1, 101)
    ]
    record = FaceRecord(log_of(rows))
    assert record.lost_periods == [(5, 7), (20, 20), (100, 100)]
    assert record.tracked_probability == pytest.approx(0.9)
    assert record.missing == [9]
    assert record.notes == [
        "Missing, unreadable or blank, and only predicted: frame 9.",
        "Lost in frames 5 to 7, 20, 100.",
        "Found again: frame 8.",
    ]
    assert record.evidence_measures == {"mean": -50.5, "median": -50.5, "lowest": -100, "lowest_frame": 100}
    assert record.error_measures(10.0) is None
    assert set(record.experts) == {4.0}
