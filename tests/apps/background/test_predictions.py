"""What a background run records of its chains' predictions."""

import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from rsmcm.apps.background.application import build_model
from rsmcm.apps.background.predictions import PixelScores, Predictions
from rsmcm.apps.evaluation.predictions import PairRecord, ScoreRecord
from rsmcm.apps.scenes import Scene, sleeping_man
from rsmcm.inference import Belief, RecursiveBP, RunState
from rsmcm.models import Frame, GivenBoxes

SCENE = sleeping_man(70, size=(160, 120), enter=0, car_leaves=70)


@pytest.fixture(scope="module")
def beliefs() -> list[Belief]:
    return list(RecursiveBP(build_model()).run(SCENE))


def recorded(beliefs: list[Belief]) -> ScoreRecord:
    predictions = Predictions(build_model())
    for belief in beliefs:
        predictions.on_frame(belief)
    (record,) = predictions.records()
    assert isinstance(record, ScoreRecord)
    return record


def test_blobs_know_more_of_the_pixels_that_they_cover(beliefs: list[Belief]) -> None:
    record = recorded(beliefs)
    assert (record.first, record.second, record.feature) == ("background", "blobs", "pixels")
    assert (np.diff(record.frames) == 10).all(), "every 0.4 s"
    background, blobs, product = record.scores.mean(axis=0)
    assert product > max(background, blobs)


def test_no_score_has_heard_of_the_frame_that_it_is_of(beliefs: list[Belief]) -> None:
    """Another image changes what is seen, and neither light nor places: of a negative nobody knows more."""
    before, belief = beliefs[59].state, beliefs[60]
    assert belief.frame.image is not None
    engine, changed = RecursiveBP(build_model()), []
    for image in (belief.frame.image, 255 - belief.frame.image):
        scores = PixelScores(build_model())
        scores.on_frame(before, engine.step(before, Frame(image, belief.frame.time, 61)))
        (record,) = scores.record()
        assert isinstance(record, ScoreRecord)
        changed.append(record.scores[0])
    uniform = -3 * np.log(256)
    assert changed[0][2] > uniform
    assert (changed[1] < uniform + 0.5).all()


def with_detector(scene: Scene, every: int) -> Iterator[Frame]:
    """A detector that finds the person within a px or two, on every n-th frame."""
    random = np.random.default_rng(0)
    for index, frame in enumerate(scene):
        boxes = [(x, y, x + width, y + height) for x, y, width, height in (b.box for b in scene.boxes(index))]
        found = np.array(boxes).reshape(-1, 4) + random.normal(0, 1.0, (len(boxes), 4))
        yield replace(frame, boxes=None if index % every else GivenBoxes(found, np.ones(len(boxes))))


def test_a_detector_observes_what_blobs_and_ground_predict() -> None:
    predictions, whole = (Predictions(build_model()) for _ in range(2))
    last = RunState()
    for index, belief in enumerate(RecursiveBP(build_model()).run(with_detector(SCENE, 2))):
        whole.on_frame(belief)
        if index == 40:  # as when a run is resumed
            saved = json.loads(json.dumps(predictions.saved()))
            predictions = Predictions(build_model())
            predictions.restore(saved, last)
        predictions.on_frame(belief)
        last = belief.state
    boxes, pixels = predictions.records()
    assert isinstance(boxes, PairRecord)
    assert isinstance(pixels, ScoreRecord)
    assert (boxes.first, boxes.second, boxes.feature, boxes.unit) == ("blobs", "ground", "boxes", "px")
    assert len(boxes.frames) > 10
    assert (boxes.frames % 2 == 1).all(), "it ran on every second frame, from the first on"
    truth = {belief: SCENE.boxes(belief - 1)[0].box for belief in boxes.frames.tolist()}
    x, y, width, height = np.array([truth[number] for number in boxes.frames.tolist()]).T
    off = boxes.predictions.observed - np.column_stack([x + width / 2, y + height, width, height])
    assert np.abs(off).max() < 8
    assert off.std() == pytest.approx(1.2, abs=0.6)
    again = whole.records()[0]
    assert isinstance(again, PairRecord)
    np.testing.assert_array_equal(again.predictions.first, boxes.predictions.first)
    np.testing.assert_array_equal(again.frames, boxes.frames)
