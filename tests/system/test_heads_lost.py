"""A head that no detector finds for two seconds, and one that was out of the picture."""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import SignerScene, signer
from rsmcm.apps.scenes.signing.faults import ListedFaces
from rsmcm.chains import ArticulatedPose, FleshTracker
from rsmcm.chains.body.samples import body_moments
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import BodyParts, Frame, UpperBody

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

NOBODY = np.zeros((0, 4))
BEFORE, GONE, AFTER = 8, 50, 12


@pytest.fixture(scope="module")
def scene() -> SignerScene:
    return signer(BEFORE + GONE + AFTER, 100, 0.0, size=(320, 180))


@pytest.fixture(scope="module")
def images(scene: SignerScene) -> list[Image]:
    return list(scene.images())


def beliefs(images: list[Image], boxes: list[Array], whole: bool) -> Iterator[tuple[Array, Array]]:
    """Head of the tracker of flesh and of the poses `(2,)` px in every frame; alone, of the first twice."""
    parts = BodyParts.learned(images, ListedFaces(tuple(boxes)))
    body = UpperBody.from_head(parts.head_height)
    flesh = FleshTracker(body)
    model = MultiChain().connect(flesh, parts)
    if whole:
        model.connect(ArticulatedPose(body, samples=100), parts)
    for belief in RecursiveBP(model).run(Frame(im, k / 25, k + 1) for k, im in enumerate(images)):
        head = belief[flesh].positions[0]
        yield head, body_moments(body, belief["pose"]).joints[0, :2] if whole else head


def test_a_detector_that_is_silent_for_two_seconds(scene: SignerScene, images: list[Image]) -> None:
    boxes = list(scene.detector.boxes)
    boxes[BEFORE : BEFORE + GONE] = [NOBODY] * GONE
    truth = scene.joints[:, 0, :2]
    found = np.array(list(beliefs(images, boxes, whole=True)))
    errors = np.linalg.norm(found - truth[:, None], axis=2) / scene.body.head_height
    assert errors.max() < 0.5


def test_somebody_who_comes_back_elsewhere(scene: SignerScene, images: list[Image]) -> None:
    """The tracker of flesh has the head again in the second frame."""
    shift = 80 if scene.joints[0, 0, 0] < 160 else -80
    room = np.full_like(images[0], 120)
    moved = [np.roll(image, shift, axis=1) for image in images[BEFORE + GONE :]]
    film = images[:BEFORE] + [room] * GONE + moved
    boxes = list(scene.detector.boxes)
    boxes[BEFORE : BEFORE + GONE] = [NOBODY] * GONE
    boxes[BEFORE + GONE :] = [each + np.array([shift, 0, 0, 0]) for each in boxes[BEFORE + GONE :]]
    found = np.array([head for head, _ in beliefs(film, boxes, whole=False)])[BEFORE + GONE + 1 :]
    truth = scene.joints[BEFORE + GONE + 1 :, 0, :2] + (shift, 0)
    assert np.linalg.norm(found - truth, axis=1).max() < 0.5 * scene.body.head_height
