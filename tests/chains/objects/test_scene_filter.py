"""The scene filter: the empty scene of a whole film, and what follows from it, none of it kept."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.background.application import build_model
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import ObjectTrajectories, SceneFilter
from rsmcm.chains.objects.scene_filter import sample_of
from rsmcm.inference import CoordinateAscent, MultiChain, RecursiveBP, Solution
from rsmcm.inference.engine.protocols import LazyFrames
from rsmcm.models import Frame, GivenBoxes, ObjectBoxes, PixelLabels

N_FRAMES = 70
SCENE = sleeping_man(130, size=(160, 120), enter=1, stand=1, car_leaves=200)
FIRST = 40
"""Somebody is in the picture from the first frame on, and walks."""

IMAGES = [frame.image for frame in SCENE][FIRST : FIRST + N_FRAMES]
TRUTH = list(SCENE.masks)[FIRST : FIRST + N_FRAMES]


class Counted(LazyFrames):
    """Frames that are made when asked for, and how often each was."""

    def __init__(self) -> None:
        self.asked = np.zeros(N_FRAMES, int)

    def __len__(self) -> int:
        return N_FRAMES

    def __getitem__(self, index: int) -> Frame:  # type: ignore[override]
        if not 0 <= index < N_FRAMES:
            raise IndexError(index)
        self.asked[index] += 1
        return Frame(IMAGES[index], self.time(index), index + 1)

    def time(self, index: int) -> float:
        return index / 25


PIXELS, BOXES = PixelLabels(), ObjectBoxes()


def film_model() -> tuple[SceneFilter, ObjectTrajectories, MultiChain]:
    scene, trajectories = SceneFilter(build_model()), ObjectTrajectories()
    model = MultiChain().connect(scene, PIXELS).connect(scene, BOXES).connect(trajectories, BOXES)
    return scene, trajectories, model


@pytest.fixture(scope="module")
def solution() -> Solution:
    """Each frame is read for the empty scene, the filter, and the time of what was seen, at most."""
    _, _, model = film_model()
    frames = Counted()
    found = CoordinateAscent(model, most_rounds=2, tolerance=None).run(frames)
    assert frames.asked[1:].max() <= 6
    assert frames.asked[1:].min() >= 1
    return found


def f_of(masks: Iterator[NDArray[np.uint8]]) -> float:
    right = wrong = 0
    for found, true in zip(masks, TRUTH, strict=True):
        right += 2 * np.count_nonzero((found > 0) & true)
        wrong += np.count_nonzero((found > 0) != true)
    return right / (right + wrong)


def test_who_is_there_in_the_first_frame_is_no_part_of_the_scene(solution: Solution) -> None:
    online = f_of(belief[PIXELS].foreground() for belief in RecursiveBP(build_model()).run(IMAGES))
    whole = f_of(message.foreground() for message in solution[PIXELS])
    assert whole > 0.75
    assert whole > online + 0.05


def test_beliefs_are_those_of_the_filter_from_its_start(solution: Solution) -> None:
    scene, _, _ = film_model()
    engine = RecursiveBP(scene.model)
    start = scene.initial_state(solution["scene"])
    for message, belief in zip(solution[PIXELS], engine.run(Counted(), state=start), strict=True):
        np.testing.assert_array_equal(message.log_odds(), belief[PIXELS].log_odds())


def test_the_second_round_knows_the_ground(solution: Solution) -> None:
    scene, _, _ = film_model()
    states = scene.initial_state(solution["scene"]).states
    assert not len(states["ground"].identities)  # nobody is there yet
    assert states["detector"].elapsed == 0.0  # boxes of other chains are no detections that failed to come
    fresh = scene.state_in(solution["scene"].empty, 0.0).states["ground"]
    assert states["ground"].scene_covariance[0, 0] < 0.5 * fresh.scene_covariance[0, 0]


def test_more_of_the_sample_is_from_the_beginning() -> None:
    times = np.arange(5000) / 25
    chosen = sample_of(times, 48, 30.0)
    assert chosen == sorted(set(chosen))
    assert len(chosen) == 48
    assert times[chosen][24] == pytest.approx(30 * np.log(2), rel=0.1)
    assert chosen[-1] > 2000
    assert sample_of(times[:7], 48, 30.0) == list(range(7))
    assert sample_of(times[:1], 48, 30.0) == [0]
    steps = np.diff(sample_of(times[:100], 10, 30.0))
    assert set(steps.tolist()) <= {9, 10, 11}  # a short film: evenly


def test_with_a_detector_the_objects_are_those_that_it_confirms() -> None:
    scene, _, model = film_model()
    stands = GivenBoxes(np.array([[60.0, 20, 80, 100]]))  # where nobody walks
    frames = [replace(frame, boxes=stands) for frame in Counted()][:30]
    solution = CoordinateAscent(model, most_rounds=1, tolerance=None).run(frames)
    start = scene.initial_state(solution[scene])
    said = solution.messages(scene, BOXES)
    for time, belief in enumerate(RecursiveBP(scene.model).run(frames, state=start)):
        expected = [track.identity for track in belief["blobs"].tracks()]
        assert said[time].objects.identities.tolist() == expected
