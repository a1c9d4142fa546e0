"""Recovery of a lost object: dispersed starts, trust, views of detectors, poses in boxes."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.face.recovery import (
    ASIDE,
    AWAY_FOR,
    CHANCE,
    CHANCE_ANYWHERE,
    FARTHEST_AHEAD,
    HERE_FOR,
    LEAST_SHARE,
    MAX_DOUBT_TIME,
    MEMORY,
    SHORTEST_TRIAL,
    STRAIGHT,
    TRIAL,
    TRIED_TURNS,
    WIDTH_OF_FACE,
    DetectedFace,
    Trust,
    UprightView,
    align_to_detections,
    disperse,
    poses_in_boxes,
    roll_angles,
)
from rsmcm.models.core.frame import Frame
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.numerics.rotations import exponential
from scipy.stats import norm

N, BASES = 4000, 3


def test_shares_of_the_motion_and_steps_aside() -> None:
    poses = Poses.upright(np.zeros((N, 2)), np.full(N, 40.0), BASES)
    motion = np.zeros((N, poses.dimension))
    motion[:, 3] = 10.0
    walk = np.array([0.01, 0.02, 0.01, 4.0, 9.0, 1.0, 2.0, 3.0])
    changes = disperse(poses, motion, walk, np.random.default_rng(0)).changes_from(poses)
    straight = np.abs(np.delete(changes, 3, axis=1)).max(axis=1) < 1e-12
    bar = 5 / np.sqrt(N)
    assert abs(straight.mean() - STRAIGHT) < bar
    ahead = changes[straight, 3] / 10.0
    assert ahead.min() >= 0
    assert ahead.max() <= FARTHEST_AHEAD
    assert abs(ahead.mean() - FARTHEST_AHEAD / 2) < bar * FARTHEST_AHEAD
    np.testing.assert_allclose(changes[~straight, 4].std(), ASIDE * 3.0, rtol=bar)
    np.testing.assert_allclose(changes[~straight, 5:].std(axis=0), ASIDE * np.sqrt(walk[5:]), rtol=bar)


def test_usual_fit_is_that_of_the_last_second() -> None:
    trust = Trust()
    for _ in range(10):
        trust = trust.confirmed(0.4, 9.0, MEMORY / 10)
    assert trust.usual_fit == pytest.approx(0.4 + 0.6 * np.exp(-1))
    half = Trust().confirmed(0.4, 9.0, 0.3).confirmed(0.4, 9.0, 0.7)
    assert half.usual_fit == pytest.approx(trust.usual_fit), "it is the same at any rate"
    assert trust.doubted(0.04).usual_fit == trust.usual_fit, "what is doubted is not usual"


def test_what_is_too_little_depends_on_what_is_usual() -> None:
    assert Trust(usual_fit=0.9).least_fit == pytest.approx(0.9 * LEAST_SHARE)
    assert Trust(usual_fit=0.6).least_fit < Trust(usual_fit=0.9).least_fit
    assert Trust(usual_fit=0.1).least_fit == CHANCE
    assert Trust(usual_fit=0.1).return_fit == CHANCE_ANYWHERE
    assert Trust(usual_fit=0.9).return_fit == Trust(usual_fit=0.9).least_fit


def test_less_in_view_is_less_evidence() -> None:
    """Log likelihood ratios are proportional to the area; more than usual is no better."""
    usual = Trust().confirmed(0.8, 100.0, 0.04)
    for area in (0.0, 25.0, 100.0):
        ratio = np.log1p(-usual.evidence(0.6, area)) / np.log1p(-0.6)
        assert ratio == pytest.approx(area / 100)
    assert usual.evidence(0.6, 300.0) == Trust().evidence(0.6, 7.0) == pytest.approx(0.6)
    assert usual.evidence(-0.5, 50.0) < 0


def test_probability_is_that_of_a_chain_of_two_states() -> None:
    """Its forward step, with the densities of scipy; at any frame rate without evidence."""
    trust = Trust(usual_fit=0.8, usual_area=100.0, probability=0.7)
    usual, chance, dt = norm(0.8, 0.2), norm(0.0, CHANCE / 2), 0.04
    leaves, returns = -np.expm1(-dt / HERE_FOR), -np.expm1(-dt / AWAY_FOR)
    for fit in (0.1, 0.3, 0.5, 0.79):
        here = (0.7 * (1 - leaves) + 0.3 * returns) * usual.pdf(fit)
        away = (0.7 * leaves + 0.3 * (1 - returns)) * chance.pdf(fit)
        assert trust.probability_after(fit, 100.0, dt) == pytest.approx(here / (here + away))
    assert trust.probability_after(0.9, 100.0, dt) > 0.99, "a better fit than usual is no doubt"


def test_what_is_covered_becomes_improbable_and_what_is_seen_again_probable() -> None:
    trust = Trust(usual_fit=0.8, usual_area=100.0)
    found = []
    for fit in [0.8] * 5 + [0.0] * 5 + [0.8] * 5:
        trust = replace(trust, probability=trust.probability_after(fit, 100.0, 0.04))
        found.append(trust.probability)
    assert min(found[:5]) > 0.99
    assert max(found[6:10]) < 0.1
    assert min(found[11:]) > 0.9


@pytest.mark.parametrize(("dt", "pictures"), [(0.04, 3), (1 / 30, 3), (0.2, 2), (10.0, 2)])
def test_lost_after_some_doubt(dt: float, pictures: int) -> None:
    trust = Trust()
    for _ in range(pictures - 1):
        trust = trust.doubted(dt)
        assert not trust.lost
    assert trust.doubted(dt).lost
    assert not trust.doubted(dt).confirmed(0.8, 9.0, dt).lost


def test_a_trial() -> None:
    """It stays lost until the object was there for long enough; less long if its texture says so, too."""
    lost = Trust(usual_fit=0.8, doubt=2 * MAX_DOUBT_TIME, searches=3)
    for matches, seconds in ((True, SHORTEST_TRIAL), (False, TRIAL)):
        trust, pictures = lost.start_trial(matches=matches), 0
        while trust.trial:
            assert trust.lost
            trust, pictures = trust.continue_trial(0.9, 0.02, confirmed=True), pictures + 1
        assert pictures == round(seconds / 0.02)
        assert (trust.lost, trust.relocations, trust.searches, trust.usual_fit) == (False, 1, 0, 0.9)
    half = lost.start_trial(matches=False).continue_trial(0.9, TRIAL / 2, confirmed=True)
    assert half.continue_trial(0.9, 0.1, confirmed=False).trial == pytest.approx(TRIAL / 2 + 0.1)
    out = half.continue_trial(0.9, TRIAL, confirmed=False)
    assert (out.lost, out.trial, out.relocations) == (True, 0.0, 0)
    assert Trust().start_trial(matches=True).lost, "what is on trial may be another"
    failed = lost.start_trial(matches=False).doubted(0.02)
    assert (failed.trial, failed.lost, failed.relocations) == (0.0, True, 0)


def test_seen_again() -> None:
    again = Trust(doubt=1.0, trial=0.1, searches=4).reacquired(0.04)
    assert (again.lost, again.trial, again.searches, again.relocations) == (False, 0.0, 0, 1)
    assert again.doubted(0.04).doubted(0.04).lost, "what is found is not believed before the next picture"


MODEL = face_model()


def leaning(roll: float, place: tuple[float, float] = (150.0, 100.0), size: float = 30.0) -> Poses:
    pose = Poses.upright(np.array([place]), np.array([size]), MODEL.n_bases)
    return pose.moved(np.array([[0, 0, roll, *np.zeros(pose.dimension - 3)]]))


@pytest.mark.parametrize("roll", [0.0, -1.2])
def test_a_view_is_upright(roll: float) -> None:
    """The pose, as the view has it, is the upright one in a box; and the way back leads to it."""
    pose = leaning(roll)
    np.testing.assert_allclose(roll_angles(pose), roll, atol=1e-12)
    places = MODEL.project(pose)[0]
    view = UprightView.of(places.mean(axis=0), roll, 1.7, (200, 180))
    seen = places @ view.matrix[:, :2].T + view.matrix[:, 2]
    upright = poses_in_boxes(MODEL, np.array([[20.0, 30.0, 100.0, 120.0]]))
    typical = MODEL.project(upright)[0] * pose.sizes[0] * 1.7 / upright.sizes[0]
    np.testing.assert_allclose(seen - seen.mean(axis=0), typical - typical.mean(axis=0), atol=1e-9)
    back = view.poses(MODEL, np.array([[20.0, 30.0, 100.0, 120.0]]))
    again = MODEL.project(back)[0] @ view.matrix[:, :2].T + view.matrix[:, 2]
    np.testing.assert_allclose(again, MODEL.project(upright)[0], atol=1e-9)


def upright_faces(frame: Frame) -> NDArray[np.float64]:
    """A detector of a face that is a bright square over a dark one, as large together as a face's box."""
    image = frame.image
    assert image is not None
    bright, dark = image > 200, image < 50
    if bright.sum() < 50 or dark.sum() < 50:
        return np.zeros((0, 4))
    up, down = (np.argwhere(each).mean(axis=0)[::-1] for each in (bright, dark))
    if abs(up[0] - down[0]) > 0.2 * (down[1] - up[1]):  # it leans
        return np.zeros((0, 4))
    width = np.sqrt(float(bright.sum() + dark.sum()))
    return np.array([[*(up + down) / 2 - width / 2, width, width]])


WIDTH = 30.0 * np.ptp(MODEL.bases[0, :, 0]) / WIDTH_OF_FACE
"""px, of the box of a face of 30 px."""


def picture(roll: float) -> tuple[NDArray[np.uint8], Poses]:
    """Such a face, and its pose."""
    pose = leaning(roll)
    places = MODEL.project(pose)[0]
    rows, columns = np.indices((200, 300))
    off = np.stack([columns, rows], axis=-1) - (places.min(axis=0) + places.max(axis=0)) / 2
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    across, down = np.moveaxis(off @ turn, -1, 0) / WIDTH
    inside = (abs(across) < 0.5) & (abs(down) < 0.5)
    return np.where(inside, np.where(down < 0, 250, 5), 128).astype(np.uint8), pose


@pytest.mark.parametrize("roll", [0.0, 0.45])
def test_confirms_what_is_there(roll: float) -> None:
    image, pose = picture(roll)
    finder = DetectedFace(MODEL, upright_faces)
    assert finder.confirms(image, pose)
    aside = np.zeros((1, pose.dimension))
    aside[0, 3] = 0.3 * WIDTH
    assert not finder.confirms(image, pose.moved(aside))
    turned = np.zeros((1, pose.dimension))
    turned[0, 2] = 0.6
    assert not finder.confirms(image, pose.moved(turned))
    assert not finder.confirms(np.full_like(image, 128), pose)


@pytest.mark.parametrize("roll", [0.0, TRIED_TURNS[2]])
def test_finds_it_turned_in_the_end(roll: float) -> None:
    image, pose = picture(roll)
    finder = DetectedFace(MODEL, upright_faces)
    last = leaning(0.2, (60.0, 60.0), 26.0)
    found = [finder.find(image, last, attempt) for attempt in range(2 * len(TRIED_TURNS))]
    best = next(each for each in found if len(each) and abs(roll_angles(each)[0] - roll) < 0.1)
    off = MODEL.project(best)[0] - MODEL.project(pose)[0]
    assert np.linalg.norm(off, axis=1).mean() < 0.15 * pose.sizes[0]
    nothing = np.full_like(image, 128)
    assert not any(len(finder.find(nothing, last, attempt)) for attempt in range(6))


def test_a_pose_is_brought_to_where_it_is_shown() -> None:
    """Its turns out of the picture's plane and its expression stay."""
    last = leaning(0.3).moved(np.array([[0.2, -0.3, 0.0, *np.zeros(3), *np.full(MODEL.n_bases - 1, 4.0)]]))
    shown = leaning(-0.4, (60.0, 70.0), 45.0)
    there = align_to_detections(MODEL, last, shown)
    np.testing.assert_allclose(roll_angles(there) - roll_angles(shown), 0, atol=0.05)
    np.testing.assert_allclose(there.morphs / there.sizes[0], last.morphs / last.sizes[0])
    np.testing.assert_allclose(there.sizes, shown.sizes)
    np.testing.assert_allclose(MODEL.project(there)[0].mean(axis=0), MODEL.project(shown)[0].mean(axis=0))
    gaze = exponential(np.array([[0, 0, 0.7]]))[0] @ there.rotations[0][:, 2]
    np.testing.assert_allclose(gaze, last.rotations[0][:, 2], atol=0.05)
