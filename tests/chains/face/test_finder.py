"""Views of a picture are upright, boxes in them become poses, and a detector confirms what is there."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.chains.face.recovery import (
    TRIED_TURNS,
    DetectedFace,
    UprightView,
    align_to_detections,
    poses_in_boxes,
    roll_angles,
)
from rsmcm.models.core.frame import Frame
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import Poses
from rsmcm.models.numerics.rotations import exponential

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


def test_what_a_view_shows() -> None:
    """A bright disc is where the matrix says."""
    rows, columns = np.indices((120, 160))
    image = np.where(np.hypot(columns - 100, rows - 40) < 8, 250, 10).astype(np.uint8)
    view = UprightView.of(np.array([90.0, 50.0]), 0.4, 0.7, (80, 70))
    warp = view.warp(image)
    assert warp.shape == (70, 80)
    found = np.argwhere(warp > 130).mean(axis=0)[::-1]
    np.testing.assert_allclose(found, view.matrix @ (100, 40, 1), atol=0.5)


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


def picture(roll: float) -> tuple[NDArray[np.uint8], Poses]:
    """Such a face, and its pose."""
    pose = leaning(roll)
    box = DetectedFace(MODEL, upright_faces)._box(pose)
    rows, columns = np.indices((200, 300))
    off = np.stack([columns, rows], axis=-1) - box[0]
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    across, down = np.moveaxis(off @ turn, -1, 0) / box[1]
    inside = (abs(across) < 0.5) & (abs(down) < 0.5)
    return np.where(inside, np.where(down < 0, 250, 5), 128).astype(np.uint8), pose


@pytest.mark.parametrize("roll", [0.0, 0.45])
def test_confirms_what_is_there(roll: float) -> None:
    image, pose = picture(roll)
    finder = DetectedFace(MODEL, upright_faces)
    assert finder.confirms(image, pose)
    aside = np.zeros((1, pose.dimension))
    aside[0, 3] = 0.3 * finder._box(pose)[1]
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
