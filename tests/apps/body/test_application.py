"""`rsmcm body`, as a user runs it: on rendered films of a signer, and with what can be wrong about them."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.body import application
from rsmcm.apps.body import page as body_page
from rsmcm.apps.body.application import (
    ANGLE_NAMES,
    N_DRAWN,
    NEAR_MEAN,
    SPREAD,
    apart_and_shared,
    hands_are_seen,
    read_head,
    seen_probabilities,
)
from rsmcm.apps.body.page import BodyRecord
from rsmcm.apps.io.sources.open_source import Source, open_source
from rsmcm.apps.runs import loop
from rsmcm.apps.scenes import SignerScene, signer
from rsmcm.chains.body import start as body_start
from rsmcm.chains.body.fixed_lag import TimedSamples
from rsmcm.chains.body.flesh_tracker import FleshTracker
from rsmcm.chains.body.hand_labelling import HandLabels
from rsmcm.chains.body.samples import HANDS, BodySamples, Hypotheses
from rsmcm.chains.body.start import SavedPerson, start_from_faces, start_from_head
from rsmcm.models import Frame
from rsmcm.models.body.parts import HEAD_OF_BOX
from rsmcm.models.body.upper_body import JOINTS, PARTS, UpperBody
from scipy.special import expit
from scipy.stats import multivariate_t

from ...conftest import Command, names, summary_of
from ...support.body_poses import resting
from ...support.records import log_of

run = Command("body")
complaint = run.complaint

Image = NDArray[np.uint8]

RESULTS = {
    "film.mp4",
    "view.npz",
    "view.html",
    "poses.npz",
    "summary.json",
    "state.npz",
    "manifest.json",
}
N_FRAMES = 12
SIZE = (320, 180)
FEW = ("--samples", "100")
HEAD = JOINTS.index("head")


def poses_of(out: Path) -> dict[str, NDArray[Any]]:
    with np.load(out / "poses.npz", allow_pickle=False) as content:
        return dict(content)


def write_pictures(folder: Path, images: list[Image]) -> Path:
    folder.mkdir()
    for number, image in enumerate(images, start=1):
        cv2.imwrite(str(folder / f"frame{number}.png"), image)
    return folder


@pytest.fixture(scope="module")
def scene() -> SignerScene:
    return signer(N_FRAMES, 3, 0.0, 0.3, SIZE)


@pytest.fixture(scope="module")
def images(scene: SignerScene) -> list[Image]:
    return list(scene.images())


@pytest.fixture(scope="module")
def film(images: list[Image], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pictures(tmp_path_factory.mktemp("film") / "film", images)


def head_of(scene: SignerScene, index: int = 0) -> str:
    """The head in a frame, as somebody marks it."""
    body, (x, y) = scene.body, scene.joints[index, HEAD, :2]
    box = (x - body.head_width / 2, y - body.head_height / 2, body.head_width, body.head_height)
    return ",".join(f"{number:.0f}" for number in box)


@pytest.fixture(scope="module")
def head(scene: SignerScene) -> tuple[str, str]:
    return "--head", head_of(scene)


@pytest.fixture
def faces(scene: SignerScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene's own detector: rendered faces of this size are no training data of real ones."""
    monkeypatch.setattr(body_start, "default_faces", lambda _: scene.detector)


@pytest.fixture(scope="module")
def finished(film: Path, head: tuple[str, str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "deep" / "er"
    assert run(film, *head, "--out", out, *FEW) == 0
    return out


def apart(out: Path, scene: SignerScene, joint: int) -> NDArray[np.float64]:
    """Distances of a joint's posterior means from the truth, px, a frame each."""
    poses = poses_of(out)
    truth = scene.joints[poses["frames"] - 1, joint, :2]
    distance: NDArray[np.float64] = np.linalg.norm(poses["joints_2d"][:, joint] - truth, axis=1)
    return distance


# --- results ------------------------------------------------------------------------------------------------


def test_results(finished: Path) -> None:
    assert names(finished) == RESULTS
    summary = summary_of(finished)
    assert (summary["frames"], summary["first_frame"], summary["last_frame"]) == (N_FRAMES, 1, N_FRAMES)
    assert summary["size"] == list(SIZE)
    assert set(summary["seen"]) == set(PARTS)
    assert summary["flesh_colour"]
    assert not summary["ended_early"]
    assert summary["body"]["lengths"].keys() == {field.name for field in fields(UpperBody)}
    assert "given" in summary["body"]["origin"]
    assert summary["parameters"]["samples"] == 100


def test_poses(finished: Path, scene: SignerScene) -> None:
    poses = poses_of(finished)
    n = N_FRAMES
    shapes = {
        "frames": (n,), "times": (n,), "joints_2d": (n, 8, 2), "joints_2d_covariances": (n, 8, 2, 2),
        "joints_3d": (n, 8, 3), "joints_3d_covariances": (n, 8, 3, 3), "angles": (n, 16),
        "angle_covariances": (n, 16, 16), "samples": (n, N_DRAWN, 8, 3), "hypotheses": (n, 4),
        "hypothesis_joints": (n, 4, 8, 3), "exchanged": (n,), "relabelled": (n,), "seen": (n, 3),
        "seen_probability": (n, 3), "stationary": (n,), "missing": (n,),
        "joint_names": (8,), "part_names": (3,), "angle_names": (16,),
        "length_names": (len(fields(UpperBody)),), "lengths": (len(fields(UpperBody)),),
    }  # fmt: skip
    assert {name: array.shape for name, array in poses.items()} == shapes
    assert poses["joint_names"].tolist() == list(JOINTS)
    assert poses["part_names"].tolist() == list(PARTS)
    assert poses["angle_names"].tolist() == list(ANGLE_NAMES)
    assert poses["seen"].dtype == poses["missing"].dtype == np.bool_
    assert poses["frames"].tolist() == list(range(1, n + 1))
    np.testing.assert_allclose(poses["times"], np.arange(n) / 25, atol=1e-6)
    np.testing.assert_array_equal(poses["joints_2d"], poses["joints_3d"][..., :2])
    np.testing.assert_array_equal(poses["joints_2d_covariances"], poses["joints_3d_covariances"][..., :2, :2])
    for name in ("joints_3d_covariances", "angle_covariances"):
        assert np.linalg.eigvalsh(poses[name]).min() > -1e-6 * np.abs(poses[name]).max()
    body = UpperBody(**dict(zip(poses["length_names"].tolist(), poses["lengths"].tolist(), strict=True)))
    upper_arms = poses["samples"][:, :, JOINTS.index("left_elbow")] - poses["samples"][:, :, 2]
    np.testing.assert_allclose(np.linalg.norm(upper_arms, axis=-1), body.upper_arm, rtol=1e-4)


def test_answers_are_of_the_posterior(finished: Path) -> None:
    """The best one comes first; together they are all there is, and their mean that of the posterior."""
    poses = poses_of(finished)
    weights, joints = poses["hypotheses"], poses["hypothesis_joints"]
    assert (np.diff(weights, axis=1) <= 0).all()
    assert ((weights > 0) == np.isfinite(joints).all(axis=(2, 3))).all()
    assert ((weights > 0) == ~np.isnan(joints).all(axis=(2, 3))).all()
    whole = weights.sum(axis=1) > 1 - 1e-9
    assert whole.any()
    mean = np.einsum("fh,fhjx->fjx", weights, np.nan_to_num(joints))
    np.testing.assert_allclose(mean[whole], poses["joints_3d"][whole], atol=1e-6)
    assert ((poses["exchanged"] >= 0) & (poses["exchanged"] <= 1)).all()


def test_the_body_is_followed(finished: Path, scene: SignerScene) -> None:
    """Not how well, which is tested elsewhere, but that it is this film's body: to a head of seven."""
    for name in ("head", "neck", "left_shoulder", "right_shoulder"):
        assert np.median(apart(finished, scene, JOINTS.index(name))) < scene.body.head_height


def test_hands_change_their_names_at_the_end(
    film: Path, head: tuple[str, str], finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the whole film says so: in arrays, pictures and summary, and only there."""
    labels = body_page.label_hands

    def changed(numbers: NDArray[np.int64], *said: Any) -> HandLabels:
        found = labels(numbers, *said)
        exchanged = (numbers > 5) & (numbers < 9)
        return replace(found, probabilities=np.where(exchanged, 0.8, 0.02), exchanged=exchanged)

    monkeypatch.setattr(body_page, "label_hands", changed)
    assert run(film, *head, "--out", tmp_path, *FEW) == 0
    before, after = poses_of(finished), poses_of(tmp_path)
    chosen = (after["frames"] > 5) & (after["frames"] < 9)
    np.testing.assert_array_equal(after["relabelled"], chosen)
    np.testing.assert_allclose(after["exchanged"], np.where(chosen, 0.2, 0.02))
    hands = [JOINTS.index(f"{side}_hand") for side in ("left", "right")]
    for joints in ("joints_2d", "joints_3d"):
        np.testing.assert_array_equal(after[joints][~chosen], before[joints][~chosen])
        np.testing.assert_array_equal(after[joints][chosen][:, hands], before[joints][chosen][:, hands[::-1]])
    summary = summary_of(tmp_path)
    assert summary["relabelled"] == [[6, 8]]
    assert summary["doubts"]["exchanged"] == [[6, 8, 0.2]]
    notes = summary["notes"]
    assert "The hands may be exchanged in frames 6 to 8 (20 %)." in notes
    assert "Given the whole video, left and right hand were relabelled in frames 6 to 8." in notes


# --- who is tracked -----------------------------------------------------------------------------------------


def test_a_marked_head_gives_size_and_colour(images: list[Image], scene: SignerScene) -> None:
    """A grey image has no colour."""
    box = read_head(head_of(scene))
    start = start_from_head(Frame(images[0], 0.0, 1), box, images[:1])
    assert start.parts.head_height == start.body.head_height == box[3]
    assert start.parts.skin is not None
    assert start.notes == []
    assert start.parts.detector is not None
    assert [len(start.parts.detector(Frame(images[0], 0.0, number))) for number in (1, 2)] == [1, 0]
    odds, (x, y) = start.parts.skin.log_odds(images[0]), scene.joints[0, HEAD, :2].astype(int)
    assert odds[y : y + 10, x - 5 : x + 5].mean() > odds[:, :20].mean() + 1
    grey = start_from_head(Frame(images[0][..., 1], 0.0, 1), box, images[:1])
    assert grey.parts.skin is None
    assert "grey" in grey.notes[0]


@pytest.mark.parametrize(
    "text", ["", "1,2,3", "1,2,3,x", "1,2,0,4", "1,2,3,-4", "nan,2,3,4", "1,2,3,inf", "1,2,3,4,5"]
)
def test_heads_that_are_none(text: str) -> None:
    with pytest.raises(ValueError, match="--head: got"):
        read_head(text)


def test_a_stream_is_read_once(
    film: Path, scene: SignerScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its first frames are looked at, and then tracked."""
    opened = []

    def stream(*arguments: Any, **options: Any) -> Source:
        source = open_source(*arguments, **options)
        source.kind = "stream"
        opened.append(source)
        return source

    looked_at = []

    def faces(frame: Frame) -> NDArray[np.float64]:
        looked_at.append(frame.number)
        return scene.detector(frame)

    for module in (loop, application):
        monkeypatch.setattr(module, "open_source", stream)
    monkeypatch.setattr(application, "CALIBRATION_FRAMES", 6)
    monkeypatch.setattr(body_start, "default_faces", lambda _: faces)
    assert run(film, "--out", tmp_path, *FEW) == 0
    assert len(opened) == 1
    assert max(looked_at[:-N_FRAMES]) == 6
    assert poses_of(tmp_path)["frames"].tolist() == list(range(1, N_FRAMES + 1))


# --- hard input ---------------------------------------------------------------------------------------------


def test_missing_and_blank_frames(images: list[Image], head: tuple[str, str], tmp_path: Path) -> None:
    changed = list(images[:12])
    changed[6], changed[9] = np.zeros_like(images[0]), np.full_like(images[0], 255)
    folder = write_pictures(tmp_path / "film", changed)
    unreadable = folder / "frame4.png"
    unreadable.write_bytes(unreadable.read_bytes()[:60])
    out = tmp_path / "out"
    assert run(folder, *head, "--out", out, *FEW) == 0
    summary, poses = summary_of(out), poses_of(out)
    assert summary["missing"] == [4, 7, 10]
    assert summary["blank"] == [7, 10]
    assert np.flatnonzero(poses["missing"]).tolist() == [3, 6, 9]
    assert not poses["seen"][[3, 6, 9]].any()
    assert np.isfinite(poses["joints_3d"]).all()
    assert any("frames 4, 7, 10" in note for note in summary["notes"])
    film = cv2.VideoCapture(str(out / "film.mp4"))
    assert sum(iter(lambda: film.read()[0], False)) == 12


def test_nothing_to_see(tmp_path: Path, head: tuple[str, str], capfd: pytest.CaptureFixture[str]) -> None:
    folder = write_pictures(tmp_path / "film", [np.zeros((180, 320), np.uint8)] * 3)
    for arguments in (head, ()):
        message = complaint(capfd, folder, "--out", tmp_path / "out", *arguments)
        assert "holds only blank frames" in message
    assert not (tmp_path / "out").exists()


def test_wrong_arguments(
    film: Path,
    head: tuple[str, str],
    scene: SignerScene,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(cv2, "CascadeClassifier", raising=False)
    out = ("--out", tmp_path / "out")
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"no network")
    for arguments, words in (
        ((film, *out), "no face detector, expected a model file of YuNet as --detector, or the head"),
        ((film, *out, "--detector", bad), "bad.onnx: is no model"),
        ((film, *out, "--detector", tmp_path / "nowhere.onnx"), "nowhere.onnx: no such file"),
        ((film, *out, "--head", "1,2,3"), "--head: got '1,2,3', expected x,y,width,height in px"),
        ((film, *out, "--head", "400,10,30,40"), "expected the head inside the picture of 320x180 px"),
        ((film, *out, "--head=-90,10,30,40"), "expected the head inside the picture of 320x180 px"),
        ((film, *out, *head, "--samples", 9), "--samples: got 9, expected 10 or more"),
        ((film, *out, *head, "--samples", "many"), "--samples"),
        ((film, *out, *head, "--lag", -1), "--lag: got -1, expected 0 to 250 frames"),
        ((film, *out, *head, "--start", 99), "start: got 99"),
        ((tmp_path / "nowhere", *out, *head), "no such file or folder"),
        ((film, *head), "--out is needed"),
    ):
        assert words in complaint(capfd, *arguments), arguments
        assert not (tmp_path / "out").exists()


# --- record -------------------------------------------------------------------------------------------------


def test_a_record_of_any_length() -> None:
    body = UpperBody.from_head(50.0)
    joints = body.joints(resting(np.array([[30.0, 20.0]])))[0]
    elsewhere = joints.copy()
    elsewhere[HANDS[0], 0] += 30
    certain, doubtful = (
        Hypotheses(np.array([1 - second, second, 0, 0]), np.stack([joints, elsewhere, joints, joints]), 10.0)
        for second in (0.02, 0.3)
    )
    rows = []
    for number in range(1, 101):
        stationary, missing = number in (5, 6, 7, 20), number == 9
        answers = doubtful if 40 <= number < 60 else certain
        rows.append(
            {
                "missing": np.bool_(missing),
                "stationary": np.bool_(stationary),
                "joints_3d": joints,
                "joints_3d_covariances": np.tile(4 * np.eye(3), (8, 1, 1)),
                "seen": np.array([True, number % 4 != 0, number % 4 == 0]) & ~missing,
                "hypotheses": answers.weights,
                "unsure": np.concatenate([[0.0], answers.unsure]),
                "log_evidence": np.nan if missing or stationary else float(-number),
                "effective": 50.0,
                "exchange_log_odds": -3.0,
                "confusable": 0.0,
            }
        )
    record = BodyRecord(log_of(rows))
    assert record.stationary_periods == [(5, 7), (20, 20)]
    assert record.missing == [9]
    assert record.shares_seen == {"head": 1.0, "left_hand": 74 / 99, "right_hand": 25 / 99}
    notes = record.notes
    assert notes[0] == "Missing, unreadable or blank, and only predicted: frame 9."
    assert notes[2].endswith("only predicted, in frames 5 to 7, 20.")
    assert notes[1] == "The left hand may be elsewhere in frames 40 to 59 (30 %)."
    assert record.doubts == {"exchanged": [], "left_hand": [(40, 59, 0.3)], "right_hand": []}
    assert notes[3].startswith(
        "The right hand was not seen, or not separable from the face, in 75 % of the frames: "
    )
    assert len(notes) == 4
    assert np.flatnonzero(np.isnan(record.log_evidence)).tolist() == [4, 5, 6, 8, 19]
    np.testing.assert_allclose(record.places[0][0], joints[HEAD])
    np.testing.assert_allclose(record.stds, 2.0)


def test_of_several_faces_the_one_that_is_pointed_at(
    images: list[Image], scene: SignerScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a detector, the head that is marked says whose face is meant; without it, it is the largest."""
    x, y, width, height = read_head(head_of(scene))
    own = (x, y, width, height)

    def faces(_: Frame) -> NDArray[np.float64]:
        return np.array([(20.0, 20.0, 60.0, 60.0), (x, y + 0.1 * height, 0.75 * height, 0.75 * height)])

    monkeypatch.setattr("rsmcm.chains.body.start.default_faces", lambda path: faces)
    largest = start_from_faces("film", images, Path("any.onnx"))
    meant = start_from_faces("film", images, Path("any.onnx"), own)
    assert largest.parts.head_height == pytest.approx(HEAD_OF_BOX * 60)
    assert meant.parts.head_height == pytest.approx(HEAD_OF_BOX * 0.75 * height)
    again = SavedPerson.of(meant).start(Path("any.onnx"))
    assert again.parts.bare == meant.parts.bare
    assert again.parts.others is meant.parts.others
    assert SavedPerson.of(meant).elsewhere().person.parts.others is None


def test_where_only_a_face_is_in_view_no_hand_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A face that moves a little, above neck and shoulders."""

    def detector(frame: Frame) -> NDArray[np.float64]:
        return np.array([[104 + 6 * np.sin(frame.number - 1), 65, 113, 113]])

    monkeypatch.setattr(body_start, "default_faces", lambda _: detector)
    pictures = []
    for number in range(12):
        picture = np.full((240, 320, 3), (170, 150, 120), np.uint8)
        x = 160 + round(6 * np.sin(number))
        cv2.rectangle(picture, (70, 210), (250, 239), (60, 120, 40), cv2.FILLED)
        for centre, axes in (((x, 110), (52, 75)), ((160, 190), (30, 45))):
            cv2.ellipse(picture, centre, axes, 0, 0, 360, (90, 130, 200), cv2.FILLED)
        noise = np.random.default_rng(number).normal(0, 3, picture.shape)
        pictures.append((picture + noise).clip(0, 255).astype(np.uint8))
    film = write_pictures(tmp_path / "film", pictures)
    assert run(film, "--out", tmp_path / "out", *FEW) == 0
    poses = poses_of(tmp_path / "out")
    assert poses["seen_probability"][:, 1:].max() < 0.5
    assert np.linalg.norm(poses["joints_2d"][:, HEAD] - (160, 110), axis=1).max() < 40


@given(st.floats(0, 2.5), st.floats(-20, 20), st.floats(-20, 20), st.integers(0, 2**32 - 1))
def test_skin_of_both_hands_is_that_of_one(apart: float, left: float, right: float, seed: int) -> None:
    """The share of two discs by Monte Carlo; a hand that is not visible has none."""
    body, random, n = UpperBody.from_head(80.0), np.random.default_rng(seed), 20_000
    hands = np.array([[100.0, 100.0], [100.0 + apart * body.hand, 100.0]])
    away, shared = apart_and_shared(body, hands, np.zeros((2, 2)))
    disc = body.hand * np.sqrt(random.random(n)) * np.exp(2j * np.pi * random.random(n))
    expected = np.mean(np.abs(disc - apart * body.hand) < body.hand)
    assert shared == pytest.approx(expected, abs=5.5 * np.sqrt(0.25 / n))
    np.testing.assert_array_equal(away, 0)
    stated, visible = hands_are_seen(away, shared, np.array([left, right])), expit([left, right])
    np.testing.assert_allclose(stated, visible * (1 - 0.5 * shared * visible[::-1]))


def test_doubt_of_a_gaussian_posterior_is_that_of_students_distribution() -> None:
    """With two degrees of freedom, of hands that are surely visible; nothing of the hidden one."""
    body, random, n = UpperBody.from_head(80.0), np.random.default_rng(5), 20_000
    poses, near = resting(np.full((n, 2), 150.0)), NEAR_MEAN * body.head_height
    tracks = FleshTracker(body).initial(Frame(np.zeros((360, 640, 3), np.uint8), 0.0, 1))
    odds = np.tile([50.0, -np.inf], (n, 1))
    for std in (0.1 * near, 0.4 * near, near):
        apart = std * random.standard_normal((n, 2))
        samples = BodySamples.even(replace(poses, roots=poses.roots + apart), (360, 640), random)
        stated = seen_probabilities(body, tracks, TimedSamples(1, 0.0, samples, hand_log_odds=odds))
        reach = near / std / np.sqrt(SPREAD)
        within = multivariate_t(df=2, shape=np.eye(2)).rvs(n, random_state=random)
        expected = np.mean(np.square(within).sum(axis=1) < reach**2)
        assert stated[1] == pytest.approx(expected, abs=5 / np.sqrt(2 * n))
        assert stated[2] == 0
