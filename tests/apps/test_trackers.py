"""Trackers that are given one image after the other."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rsmcm.apps import BodyTracker, FaceTracker, ObjectTracker, PointTracker
from rsmcm.apps.background.application import build_model
from rsmcm.apps.scenes import face, signer, sleeping_man, turntable
from rsmcm.apps.trackers import body
from rsmcm.apps.trackers import face as trackers_face
from rsmcm.chains import ArticulatedPose, FleshTracker, GFlow, RecursiveStructure
from rsmcm.chains import PointTracker as PointChain
from rsmcm.chains.body.start import start_from_head
from rsmcm.chains.face.recovery import DetectedFace
from rsmcm.chains.face.start import start_from_box
from rsmcm.inference import Belief, MultiChain, RecursiveBP
from rsmcm.models import Frame, PixelLabels, PointTracks
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.detectors import default_faces

N_FRAMES = 12
IMAGE = np.full((48, 64, 3), 90, np.uint8)


@dataclass(frozen=True)
class Case:
    """A tracker, images for it with what is given at the first, and the same model run by hand."""

    make: Callable[[], Any]
    images: list[Any]
    first: dict[str, Any]
    by_hand: Callable[[], list[Any]]

    def results(self, tracker: Any, start: int, end: int) -> list[Any]:
        given = self.first if start == 0 else {}
        return [
            tracker.update(image, **(given if n == 0 else {}))
            for n, image in enumerate(self.images[start:end])
        ]


def _beliefs(model: MultiChain, images: list[Any]) -> list[Belief]:
    return list(RecursiveBP(model).run(images))


def _objects() -> Case:
    images = [frame.image for frame in sleeping_man(N_FRAMES, size=(160, 120), enter=0)]
    return Case(ObjectTracker, images, {}, lambda: [b["pixels"] for b in _beliefs(build_model(), images)])


def _face() -> Case:
    images = [frame.image for frame in face(N_FRAMES, size=(160, 120))]
    box = (50.0, 20.0, 110.0, 85.0)

    def by_hand() -> list[Any]:
        start = start_from_box(face_model(), (50.0, 20.0, 60.0, 65.0))
        finder = DetectedFace(start.model, default_faces())
        chain = GFlow(start.model, start.pose, experts=4, finder=finder, seed=3)
        return [b[chain] for b in _beliefs(MultiChain().connect(chain, PixelLabels()), images)]

    return Case(lambda: FaceTracker(experts=4, seed=3), images, {"box": box}, by_hand)


def _body() -> Case:
    scene = signer(N_FRAMES, size=(240, 180))
    images = [frame.image for frame in scene]
    head = (100.0, 20.0, 135.0, 62.0)

    def by_hand() -> list[Any]:
        person = start_from_head(Frame(images[0], 0.0, 1), (100.0, 20.0, 35.0, 42.0), images[:1])
        pose = ArticulatedPose(person.body, 50)
        model = MultiChain().connect(FleshTracker(person.body), person.parts).connect(pose, person.parts)
        return [b[pose] for b in _beliefs(model, images)]

    return Case(lambda: BodyTracker(samples=50), images, {"head": head}, by_hand)


def _points() -> Case:
    images = list(turntable(N_FRAMES, (144, 180)).images)

    def by_hand() -> list[Any]:
        chain = PointChain(n_points=40)
        model = MultiChain().connect(chain, node := PointTracks()).connect(RecursiveStructure(), node)
        return [b[chain].known for b in _beliefs(model, images)]

    return Case(lambda: PointTracker(points=40), images, {}, by_hand)


CASES = {"objects": _objects, "face": _face, "body": _body, "points": _points}


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]()


def test_results_are_those_of_the_engine_run_by_hand(case: Case) -> None:
    for got, expected in zip(case.results(case.make(), 0, N_FRAMES), case.by_hand(), strict=True):
        match got.__class__.__name__:
            case "Objects":
                np.testing.assert_array_equal(got.foreground, expected.foreground())
            case "TrackedFace":
                np.testing.assert_array_equal(
                    got.translation, expected.poses.mean(expected.weights).translations[0]
                )
            case "TrackedBody":
                angles = expected.weights @ expected.poses.angles
                np.testing.assert_allclose(got.angles, angles, rtol=1e-12, atol=1e-12)
            case _:
                np.testing.assert_array_equal(got.positions, expected.states.position[expected.alive])


def test_a_run_that_is_saved_and_restored_goes_on_with_the_same_bytes(case: Case, tmp_path: Path) -> None:
    tracker, restored = case.make(), case.make()
    case.results(tracker, 0, N_FRAMES // 2)
    kept = tracker.state
    tracker.save(tmp_path / "state.npz")
    restored.load(tmp_path / "state.npz")
    for each, path in ((tracker, "whole.npz"), (restored, "restored.npz")):
        case.results(each, N_FRAMES // 2, N_FRAMES)
        each.save(tmp_path / path)
    assert (tmp_path / "whole.npz").read_bytes() == (tmp_path / "restored.npz").read_bytes()
    tracker.state = kept  # a value: what came after has not changed it
    tracker.save(tmp_path / "kept.npz")
    assert (tmp_path / "kept.npz").read_bytes() == (tmp_path / "state.npz").read_bytes()
    tracker.reset()
    case.results(tracker, 0, N_FRAMES // 2)
    tracker.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "state.npz").read_bytes()


@pytest.fixture(scope="module")
def detected() -> tuple[ObjectTracker, Any, Any]:
    """A tracker after 45 images with a detector's boxes, the last objects, and the next image."""
    scene, tracker = sleeping_man(46, size=(160, 120), enter=0), ObjectTracker()
    for index in range(45):
        boxes = np.array([truth.box for truth in scene.boxes(index)], np.float64).reshape(-1, 4)
        boxes[:, 2:] += boxes[:, :2]
        objects = tracker.update(scene.image(index), boxes=boxes)
    return tracker, objects, scene.image(45)


def test_objects_are_the_tracks_of_the_belief(detected: Any) -> None:
    tracker, objects, _ = detected
    tracks = tracker.state.run.states["blobs"].tracks()
    assert len(objects) == len(tracks) >= 1
    x, y, width, height = tracks[0].box
    np.testing.assert_allclose(objects.boxes[0], (x, y, x + width, y + height))
    assert objects.identities.tolist() == [track.identity for track in tracks]
    np.testing.assert_array_equal(objects.velocities, [track.velocity for track in tracks])
    assert ((objects.existence > 0) & (objects.existence <= 1)).all()
    assert objects.masks.shape == (len(objects), 120, 160)
    left, top, right, bottom = (max(round(edge), 0) for edge in objects.boxes[0].tolist())
    inside = objects.foreground[top:bottom, left:right] > 0
    np.testing.assert_array_equal(objects.masks[0, top:bottom, left:right], inside)
    assert objects.masks[0].sum() == inside.sum() > 0
    assert objects._repr_html_().count("<tr>") == 1 + len(objects)


def test_a_detector_that_saw_nothing_counts_against_objects_and_one_that_did_not_run_does_not(
    detected: Any,
) -> None:
    tracker, objects, image = detected
    state, existence = tracker.state, {}
    for name, boxes in (("did not run", None), ("saw nothing", np.zeros((0, 4)))):
        tracker.state = state
        existence[name] = tracker.update(image, boxes=boxes).existence
    tracker.state = state
    assert existence["saw nothing"][0] < existence["did not run"][0]
    assert existence["did not run"][0] == pytest.approx(objects.existence[0], abs=0.01)


def test_boxes_of_supervision_are_those_of_an_array(detected: Any) -> None:
    supervision = pytest.importorskip("supervision")
    tracker, objects, image = detected
    state, results = tracker.state, []
    for boxes in (objects.boxes, supervision.Detections(xyxy=objects.boxes)):
        tracker.state = state
        results.append(tracker.update(image, boxes=boxes).to_supervision())
    tracker.state = state
    np.testing.assert_array_equal(results[0].xyxy, results[1].xyxy)
    assert results[0].tracker_id.tolist() == objects.identities.tolist()


def test_until_there_is_a_face_or_a_person_there_is_no_result() -> None:
    for tracker in (FaceTracker(), BodyTracker()):
        assert tracker.update(None) is None
        assert tracker.update(IMAGE) is None
        assert tracker.state.run.number == 2
        with pytest.raises(ValueError, match="time"):
            tracker.update(IMAGE, time=0.0)
    assert len(ObjectTracker().update(None)) == len(PointTracker().update(None)) == 0


def test_a_face_that_is_still_to_be_confirmed_is_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    detector = lambda frame: np.array([[50.0, 20.0, 60.0, 65.0]])  # noqa: E731
    monkeypatch.setattr(trackers_face, "default_faces", lambda *_: detector)
    images = [frame.image for frame in face(4, size=(160, 120))]
    whole, resumed = FaceTracker(experts=4), FaceTracker(experts=4)
    found = []
    for number, image in enumerate(images):
        found.append(whole.update(image))
        assert (resumed.update(image) is None) == (found[-1] is None)
        resumed.save(tmp_path / "state.npz")
        resumed = FaceTracker(experts=4)
        resumed.load(tmp_path / "state.npz")
        whole.save(tmp_path / "whole.npz")
        assert (tmp_path / "state.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes(), number
    assert [each is None for each in found] == [True, True, False, False]
    whole.reset()
    assert [whole.update(image) for image in (*images[:2], None, *images[:2])] == [None] * 5


def test_a_face_that_a_second_look_does_not_confirm_is_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body, "default_faces", lambda *_: lambda frame: np.array([[10.0, 9, 20, 20]]))
    monkeypatch.setattr(body, "confirmed_faces", lambda image, boxes, detector: boxes[:0])
    assert BodyTracker().update(IMAGE) is None


def test_parts_of_a_body_are_seen_with_a_probability_and_not_where_nothing_looks_like_skin() -> None:
    case = _body()
    tracker = case.make()
    shown = case.results(tracker, 0, N_FRAMES)[-1]
    assert np.all((shown.seen_probability >= 0) & (shown.seen_probability <= 1))
    np.testing.assert_array_equal(shown.seen, shown.seen_probability > 0.5)
    assert shown.seen[0]
    for nothing in (None, np.full_like(case.images[0], (120, 60, 20))):
        assert not tracker.update(nothing).seen.any()


def test_a_missing_image_is_predicted(detected: Any) -> None:
    tracker, objects, _ = detected
    state = tracker.state
    predicted = tracker.update(None)
    tracker.state = state
    assert predicted.identities.tolist() == objects.identities.tolist()
    assert not predicted.seen.any()
    moved = objects.boxes[:, :2] + objects.velocities / 25
    np.testing.assert_allclose(predicted.boxes[:, :2], moved, atol=1)


HOSTILE: dict[str, tuple[Callable[[], Any], type[Exception], str]] = {
    "image of floats": (lambda: ObjectTracker().update(IMAGE / 255), TypeError, "image"),
    "no image at all": (lambda: PointTracker().update("film.mp4"), TypeError, "image"),
    "four channels": (lambda: FaceTracker().update(np.zeros((9, 9, 4), np.uint8)), ValueError, "image"),
    "empty image": (lambda: ObjectTracker().update(np.zeros((0, 9, 3), np.uint8)), ValueError, "image"),
    "boxes with NaN": (lambda: ObjectTracker().update(IMAGE, [[0, 0, np.nan, 9]]), ValueError, "boxes"),
    "a box of 10^9 px": (lambda: ObjectTracker().update(IMAGE, [[0, 0, 1e9, 1e9]]), ValueError, "boxes"),
    "boxes of three": (lambda: ObjectTracker().update(IMAGE, np.ones((2, 3))), ValueError, "boxes"),
    "boxes in words": (lambda: ObjectTracker().update(IMAGE, "left"), ValueError, "boxes"),
    "time in words": (lambda: ObjectTracker().update(IMAGE, time="now"), TypeError, "time"),
    "time without end": (lambda: ObjectTracker().update(IMAGE, time=np.inf), ValueError, "time"),
    "a box of three": (lambda: FaceTracker().update(IMAGE, box=(1, 2, 3)), ValueError, "box"),
    "a box without area": (lambda: FaceTracker().update(IMAGE, box=(5, 5, 5, 9)), ValueError, "box"),
    "flat landmarks": (lambda: FaceTracker().update(IMAGE, landmarks=np.ones(8)), ValueError, "landmarks"),
    "a head outside": (lambda: BodyTracker().update(IMAGE, head=(90, 5, 99, 9)), ValueError, "head"),
    "wrong key points": (lambda: BodyTracker().update(IMAGE, np.ones((1, 5, 2))), ValueError, "keypoints"),
    "positions alone": (lambda: PointTracker().update(IMAGE, positions=[[1, 2]]), ValueError, "identities"),
    "no experts": (lambda: FaceTracker(experts=0), ValueError, "experts"),
    "no frame rate": (lambda: ObjectTracker(frame_rate=0), ValueError, "frame_rate"),
    "unknown camera": (lambda: ObjectTracker(camera="drone"), ValueError, "camera"),
    "unknown parameter": (lambda: ObjectTracker(parameters={"blobs": {"mass": 1}}), ValueError, "mass"),
    "a state that is none": (lambda: setattr(ObjectTracker(), "state", 3), TypeError, "state"),
    "another tracker's state": (
        lambda: setattr(ObjectTracker(), "state", PointTracker().state), ValueError, "state",
    ),
    "other parameters": (
        lambda: setattr(BodyTracker(samples=10), "state", BodyTracker(samples=20).state),
        ValueError,
        "samples: got 20, expected 10",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_wrong_is_one_line_that_names_it(name: str) -> None:
    call, error, named = HOSTILE[name]
    with pytest.raises(error, match=named) as complaint:
        call()
    assert "\n" not in str(complaint.value)


def test_an_image_of_another_size_or_an_earlier_time_is_refused(detected: Any) -> None:
    tracker, _, image = detected
    with pytest.raises(ValueError, match=r"expected \(120, 160, 3\)"):
        tracker.update(IMAGE)
    with pytest.raises(ValueError, match="time"):
        tracker.update(image, time=0.0)


def test_a_file_that_is_no_state_of_the_tracker_is_named(tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    PointTracker().save(path)
    with pytest.raises(
        ValueError, match=r"state\.npz.*got one of PointTracker, expected one of ObjectTracker"
    ):
        ObjectTracker().load(path)
