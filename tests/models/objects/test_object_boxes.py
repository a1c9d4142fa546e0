"""Boxes of a detector as evidence, as a camera sees them that moves."""

import numpy as np
import pytest
from rsmcm.models import Frame, ObjectBoxes
from rsmcm.models.camera.moving_camera import UNKNOWNS, AffineMap, View
from rsmcm.models.core.frame import GivenBoxes
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.objects.box_message import BoxMessage, LogOdds

SIZE = (240, 320)
BOXES = np.array([[80.0, 150, 30, 70], [200.0, 180, 35, 80]])  # in the scene: foot x, foot y, width, height
ZOOM = np.array([6.0, 40.0, 0.0, -4.0, 0.0, 40.0])  # by a fifth, and a shift
NODE = ObjectBoxes()


def view(parameters: np.ndarray, unsure: float = 1e-4) -> View:
    return View.predicted(parameters, unsure**2 * np.eye(UNKNOWNS), np.zeros(SIZE, np.float32))


def prior(seen: View | None) -> BoxMessage:
    identities = np.array([3, 5])
    objects = GaussianMessage.from_moments(identities, BOXES + 2.0, np.tile(9.0 * np.eye(4), (2, 1, 1)))
    return BoxMessage(hidden=objects, existence=LogOdds(identities, np.full(2, 3.0)), view=seen)


def detected(boxes: np.ndarray) -> Frame:
    x, y, width, height = boxes.T
    xyxy = np.stack([x - width / 2, y - height, x + width / 2, y], axis=1)
    return Frame(np.zeros(SIZE, np.uint8), 0.0, 1, boxes=GivenBoxes(xyxy))


def test_boxes_that_a_known_map_moves_are_those_of_a_camera_that_stands() -> None:
    still = NODE.evidence(detected(BOXES), prior(None))
    seen = NODE.evidence(detected(AffineMap(ZOOM, SIZE).boxes(BOXES)), prior(view(ZOOM)))
    assert still.association is not None
    assert seen.association is not None
    np.testing.assert_allclose(seen.association.boxes, BOXES, atol=1e-9)
    np.testing.assert_allclose(seen.association.pairs, still.association.pairs, atol=1e-6)
    np.testing.assert_allclose(seen.objects.moments[1], still.objects.moments[1], atol=1e-4)


def test_what_the_border_hides_is_measured_in_the_scene() -> None:
    """A box whose feet are at the border of a frame that shows the scene larger by a fifth."""
    box = np.array([[100.0, SIZE[0], 48.0, 96.0]])
    still = NODE.evidence(detected(box), prior(None)).association
    seen = NODE.evidence(detected(box), prior(view(ZOOM))).association
    assert still is not None
    assert seen is not None
    assert still.noise[0, 1] > 40**2
    np.testing.assert_allclose(seen.noise, still.noise / 1.2**2, rtol=1e-4)


@pytest.mark.parametrize("unsure", [3.0, 20.0])
def test_what_the_map_is_unsure_of_is_noise_of_boxes(unsure: float) -> None:
    sure, not_sure = (
        NODE.evidence(detected(AffineMap(ZOOM, SIZE).boxes(BOXES)), prior(view(ZOOM, error))).association
        for error in (1e-4, unsure)
    )
    assert sure is not None
    assert not_sure is not None
    added = not_sure.noise - sure.noise
    # a shift of one pixel in the frame is less in the scene, which it shows larger by a fifth
    middles = BOXES[:, :2] - [0, 0.5] * BOXES[:, 2:]
    about = (np.stack([middles, BOXES[:, :2]], axis=1) - np.array([159.5, 119.5])) / 200
    np.testing.assert_allclose(added[:, :2], (unsure / 1.2) ** 2 * (1 + (about**2).sum(axis=2)), rtol=1e-4)
    np.testing.assert_allclose(added[:, 2:], (unsure / 1.2 * BOXES[:, 2:] / 200) ** 2, rtol=1e-4)


def test_who_is_in_the_scene_but_not_in_the_frame_is_not_missed() -> None:
    away = View.predicted(
        np.array([150.0, 0, 0, 0, 0, 0]), 1e-6 * np.eye(UNKNOWNS), np.zeros(SIZE, np.float32)
    )
    nobody = NODE.evidence(detected(np.zeros((0, 4))), prior(away)).association
    assert nobody is not None
    assert nobody.visible == pytest.approx([1.0, 0.0])


def test_outlines_of_a_detector_are_moved_as_well() -> None:
    masks = np.zeros((1, *SIZE), np.bool_)
    masks[0, 100:150, 60:90] = True
    frame = Frame(
        np.zeros(SIZE, np.uint8), 0.0, 1, boxes=GivenBoxes(np.array([[60.0, 100, 90, 150]]), masks=masks)
    )
    shift = View.predicted(
        np.array([10.0, 0, 0, -20, 0, 0]), 1e-6 * np.eye(UNKNOWNS), np.zeros(SIZE, np.float32)
    )
    association = NODE.evidence(frame, prior(shift)).association
    assert association is not None
    assert association.outlines is not None
    rows, columns = np.nonzero(association.outlines[0])
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (120, 169, 50, 79)
