"""Trials of face trackers: measures on made-up errors, honest covariances, and a short clip in earnest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.experiments import faces
from rsmcm.apps.experiments.faces import (
    Clip,
    Evaluation,
    Measured,
    Tracker,
    vertex_errors,
)
from rsmcm.apps.io.files import write_image
from rsmcm.apps.scenes import face
from rsmcm.chains.face.start import start_from_landmarks
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import Poses

SIZE, DT = 40.0, 0.04


def evaluation(errors: list[float]) -> Evaluation:
    values = np.array(errors, np.float64)
    return Evaluation(values, 2 * values, SIZE, DT)


def test_lost_at_the_end_or_for_more_than_a_second() -> None:
    assert not evaluation([1.0] * 60).lost
    assert evaluation([1.0] * 60 + [21.0]).lost, "half the size is 20 px"
    assert not evaluation([1.0] * 20 + [30.0] * 25 + [1.0] * 20).lost, "a second is not more than one"
    assert evaluation([1.0] * 20 + [30.0] * 26 + [1.0] * 20).lost


def test_depth_offset_is_no_error_and_shift_is() -> None:
    model = face_model(1)
    pose = Poses.upright(np.array([[50.0, 60.0]]), np.array([30.0]), model.n_bases)
    shifted = replace(pose, translations=pose.translations + np.array([3.0, 4.0]))
    flat, deep = vertex_errors(model.positions(shifted), model.positions(pose))
    assert flat[0] == pytest.approx(5.0)
    assert deep[0] == pytest.approx(5.0)
    turned = pose.moved(np.eye(pose.dimension)[1:2] * 0.1)
    flat, deep = vertex_errors(model.positions(turned), model.positions(pose))
    assert deep[0] > flat[0] > 0


@pytest.fixture(scope="module")
def clip() -> Clip:
    return Clip.of(n_frames=12, seed=3, light=0.0, size=(160, 120))


def test_oracle_is_a_floor(clip: Clip) -> None:
    settings = {"gain": 0.05, "texels": 400, "experts": 2}
    oracle = Tracker("oracle", settings, oracle=True).run(clip)
    own = Tracker("own", settings).run(clip)
    assert oracle.errors[0] == 0
    assert oracle.error < 0.5
    assert own.error > 0.7 * oracle.error
    assert not own.lost


@pytest.mark.slow
def test_a_known_texture_brings_scattered_experts_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faces, "RECOVERY_SCENE", {"n_frames": faces.SOON + 1})
    for seed in range(4):
        assert faces.recover(faces.N_EXPERTS, seed)[faces.KNOWN].errors[faces.SOON] < faces.NEAR


def made_up(errors: dict[str, float], usual: float, names: list[str]) -> Measured:
    return {name: [evaluation([0.0] + [errors.get(name, usual)] * 5) for _ in range(4)] for name in names}


def test_claims_of_experts() -> None:
    names = [tracker.name for tracker, _ in faces.EXPERTS]
    good = made_up({faces.ONE: 5.0, faces.DENSE_FLOW: 2.0, faces.DENSE: 0.5}, 0.5, names)
    assert all(
        expectation.verdict == "pass"
        for expectation in faces.expected_of_experts(good)
        if expectation.bound is not None
    )
    poor = {**good, faces.DENSE: [evaluation([0.0] + [25.0] * 5) for _ in range(4)]}
    assert sum(expectation.verdict == "missed" for expectation in faces.expected_of_experts(poor)) == 4


def test_claims_of_gain() -> None:
    names = [tracker.name for tracker in faces.GAIN_TRACKERS]
    steady = made_up({"0.01": 0.4, faces.LEARNED: 0.42}, 0.9, names)
    changing = made_up({"0.999": 0.8, faces.LEARNED: 0.9}, 1.5, names)
    expectations = faces.expected_of_gains({faces.STEADY: steady, faces.CHANGING: changing})
    assert [expectation.verdict for expectation in expectations] == ["pass", "", "pass", "pass", "missed"]


@pytest.mark.parametrize("method", [faces.EXACT, faces.ALL])
def test_a_run_with_a_background(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faces, "BACKGROUND_FRAMES", 5)
    monkeypatch.setattr(faces, "BACKGROUND_EXPERTS", 2)
    one = faces.follow_case((faces.MOVING, method), 1)[method]
    assert len(one.errors) == 5
    assert one.error < 2
    assert one.time > 0
    assert not one.lost


def test_landmarks_are_followed_through_a_film(tmp_path: Path) -> None:
    scene = face(4, 3, (160, 120))
    for number, image in enumerate(scene.images()):
        write_image(tmp_path / f"{number}.png", image)
    start = faces.Start(start_from_landmarks(scene.model, scene.vertices[1]), 1)
    (trial,) = faces.follow_landmarks(tmp_path, scene.vertices, {"a": start}, "a", 0).values()
    unit = np.linalg.norm(np.diff(scene.vertices[0, list(faces.PUPILS)], axis=0))
    assert trial.errors.shape == (3,)
    assert trial.errors[0] < 1
    assert trial.errors.max() < 100 * 2 / unit, "2 px"
    assert trial.lost == 0


def test_claims_of_landmarks_are_means_over_seeds() -> None:
    def trials(*errors: float) -> dict[str, list[faces.FilmTrial]]:
        return {"": [faces.FilmTrial(np.array([0.0, error]), 3) for error in errors]}

    measured = {faces.SURREY: trials(8.0, 12.0), faces.OWN: trials(9.0)}
    expectations = faces.expected_of_landmarks(measured)
    assert [each.measured for each in expectations] == [5.0, 10.0, 3.0, 4.5]
    assert [each.verdict for each in expectations] == ["pass", "pass", "missed", "pass"]
