"""What images say of head and hands."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.body.parts import ANYWHERE, CENTRE_OF_BOX, HEAD_OF_BOX, BodyParts, PartMessage
from rsmcm.models.body.skin import SkinColour
from rsmcm.models.core.frame import Frame
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures
from rsmcm.models.face.detectors import HaarFaces
from scipy.special import logsumexp

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

HEIGHT = 80.0
HEAD, LEFT, RIGHT = np.array([160.0, 70.0]), np.array([215.0, 180.0]), np.array([100.0, 170.0])
SIDE = HEIGHT / HEAD_OF_BOX
BOX = np.array([HEAD[0] - SIDE / 2, HEAD[1] - CENTRE_OF_BOX * SIDE, SIDE, SIDE])


def picture(head: bool = True, hands: tuple[Array, ...] = (LEFT, RIGHT), seed: int = 0) -> Image:
    """A person's head and hands before a wall, noise of 3 levels."""
    rows, columns = np.mgrid[:240, :320]
    image = np.broadcast_to(np.array([150.0, 110.0, 90.0]), (240, 320, 3)).copy()
    image[125:, 90:230] = 40
    covered = np.zeros((240, 320), np.bool_)
    if head:
        covered |= np.hypot((columns - HEAD[0]) / (0.36 * HEIGHT), (rows - HEAD[1]) / (0.5 * HEIGHT)) < 1
    for x, y in hands:
        covered |= np.hypot(columns - x, rows - y) < 0.24 * HEIGHT
    image[covered] = (90, 130, 200)
    image += np.random.default_rng(seed).normal(0, 3, image.shape)
    return image.clip(0, 255).astype(np.uint8)


class Faces:
    """Gives the boxes it was given."""

    def __init__(self, *boxes: Array) -> None:
        self.boxes = np.array(boxes).reshape(-1, 4)

    def __call__(self, frame: Frame) -> Array:
        return self.boxes


def learned(*boxes: Array) -> BodyParts:
    skin = SkinColour.learned([picture()], BOX[None])
    assert skin is not None
    return BodyParts(HEIGHT, skin, Faces(*boxes))


def heaviest(mixtures: GaussianMixtures, part: int) -> Array:
    weights = np.where(mixtures.flat[part], -np.inf, mixtures.log_weights[part])
    return mixtures.means[part, weights.argmax()]


def test_head_and_hands() -> None:
    node = learned(BOX)
    seen = node.evidence(Frame(picture(seed=1), 0.0, 1), node.uniform()).image
    assert seen is not None
    assert seen.size == (240, 320)
    np.testing.assert_allclose(heaviest(seen.mixtures, 0), HEAD, atol=2)
    for hand in (LEFT, RIGHT):
        assert np.hypot(*(seen.blobs[:2] - hand).T).min() < 5
        # both hands have the same blobs: which is whose, the image does not say
        values = seen.mixtures.log_values(np.broadcast_to(hand, (1, 3, 2)).astype(np.float64))
        assert values[0, 1] == values[0, 2]
        assert values[0, 1] > 1 + seen.mixtures.log_values(np.full((1, 3, 2), 20.0))[0, 1]
    np.testing.assert_array_equal(seen.mixtures.labels[1], seen.mixtures.labels[2])


def test_evidence_is_a_ratio_of_probabilities() -> None:
    """One face, detected: over the picture's area it averages P / (false ones) + 1 - P, 0.8 and 0.05."""
    node = learned(BOX)
    seen = node.evidence(Frame(picture(), 0.0, 1), node.uniform()).image
    assert seen is not None
    area = 240 * 320
    mixtures = seen.mixtures
    average = logsumexp(mixtures.log_weights[0] + np.where(mixtures.flat[0], 0.0, -np.log(area)))
    assert average == pytest.approx(np.log(0.8 / 0.05 + 0.2), abs=1e-9)


def test_no_face_detected() -> None:
    """The head is where a head's size of skin is, less surely."""
    node, other = learned(), learned(BOX)
    frame = Frame(picture(), 0.0, 1)
    without, with_face = (each.evidence(frame, each.uniform()).image for each in (node, other))
    assert without is not None
    assert with_face is not None
    np.testing.assert_allclose(heaviest(without.mixtures, 0), HEAD, atol=8)
    assert np.isfinite(without.mixtures.log_weights[0, without.mixtures.flat[0]]).any()
    here = np.broadcast_to(HEAD, (1, 3, 2)).astype(np.float64)
    away = np.full((1, 3, 2), 20.0)

    def contrast(mixtures: GaussianMixtures) -> float:
        return float((mixtures.log_values(here) - mixtures.log_values(away))[0, 0])

    assert 0 < contrast(without.mixtures) < contrast(with_face.mixtures)


def told(mean: Array, deviation: float) -> PartMessage:
    none, nowhere = np.zeros((0, 2)), np.zeros((0, 2, 2))
    mixtures = GaussianMixtures.of_parts(
        [[0.0], [], []],
        [mean[None], none, none],
        [deviation**2 * np.eye(2)[None], nowhere, nowhere],
        [-np.inf, 0.0, 0.0],
    )
    return PartMessage(mixtures)


def test_prior_tells_the_head_from_the_hands() -> None:
    """Without a face, chains that know the head's place keep its skin from being taken for a hand's."""
    node = learned()
    frame = Frame(picture(hands=(HEAD + np.array([4.0, 55.0]),)), 0.0, 1)

    def weight_of_the_head(prior: PartMessage) -> float:
        seen = node.evidence(frame, prior).image
        assert seen is not None
        inside = np.hypot(*((seen.blobs - HEAD) / (0.36 * HEIGHT, 0.45 * HEIGHT)).T) < 1
        return float(seen.blob_log_weights[inside].max())

    vague, sure = weight_of_the_head(told(HEAD, 60.0)), weight_of_the_head(told(HEAD, 6.0))
    assert vague == weight_of_the_head(node.uniform())
    assert sure < vague - 1


def test_learned_from_a_clip() -> None:
    """Sizes are the median of the faces', and images without a face do not matter."""
    node = BodyParts.learned([picture(seed=seed) for seed in range(3)], Faces(BOX))
    assert node.head_height == pytest.approx(HEIGHT)
    assert node.skin is not None
    with pytest.raises(ValueError, match="images: got no face in 2 of 2, expected one at least"):
        BodyParts.learned([picture(), picture()], Faces())
    with pytest.raises(ValueError, match="images: got no face in 0 of 0"):
        BodyParts.learned([], Faces(BOX))


def test_faces_are_sought_about_the_head(monkeypatch: pytest.MonkeyPatch) -> None:
    """There they are where they are in the whole picture, which is searched now and then."""
    shown: list[tuple[int, ...]] = []

    def brightest(self: HaarFaces, frame: Frame) -> Array:
        """A box about the middle of what is white, if anything is."""
        assert frame.image is not None
        shown.append(frame.image.shape[:2])
        rows, columns = np.nonzero(frame.image[..., 0] == 255)
        boxes = [[columns.mean() - 30, rows.mean() - 30, 60, 60]] if len(rows) else []
        return np.array(boxes, np.float64).reshape(-1, 4)

    monkeypatch.setattr(HaarFaces, "__call__", brightest)
    node = BodyParts(80.0, detector=HaarFaces())
    image = np.zeros((360, 640, 3), np.uint8)
    image[140:150, 300:320] = 255
    for place, number, size, found in (
        ((310.0, 150.0), 1, (200, 200), True),
        ((310.0, 150.0), ANYWHERE, (360, 640), True),
        ((40.0, 300.0), 2, (160, 140), False),
        ((40.0, 300.0), ANYWHERE, (360, 640), True),
    ):
        shown.clear()
        known = GaussianMixtures.of_parts(
            [np.zeros(1)] * 3, [np.array([place])] * 3, [25.0 * np.eye(2)[None]] * 3
        )
        heads = node._known_head(PartMessage(known), image.shape)
        faces = node._faces(Frame(image, 0.0, number), heads)
        np.testing.assert_allclose(faces, np.reshape([[279.5, 114.5, 60, 60]] * found, (-1, 4)))
        assert shown == [size]


@pytest.mark.parametrize("still", [False, True])
def test_the_neck_of_a_detected_face_explains_its_skin(still: bool) -> None:
    """Also where the scene has skin-coloured things."""
    node, neck = learned(BOX), HEAD + np.array([0.0, 0.62 * HEIGHT])
    if still:
        node = replace(node, static_skin=np.zeros((240, 320), np.float32))
    seen = node.evidence(Frame(picture(hands=(neck, RIGHT)), 0.0, 1), node.uniform()).image
    assert seen is not None
    middles, half_axes = np.split(seen.heads_and_necks, 2, axis=1)
    assert (np.square((neck - middles) / half_axes).sum(axis=1) < 1).sum() == 1
    hand, at_neck = (
        seen.blob_log_weights[np.hypot(*(seen.blobs - place).T) < 0.3 * HEIGHT].max(initial=-np.inf)
        for place in (RIGHT, neck)
    )
    assert at_neck < hand - 1
