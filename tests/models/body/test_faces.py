"""One person among the faces of several pictures."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.models.body.parts import HEAD_OF_BOX, BodyParts
from rsmcm.models.body.person import OtherFaces, find_face_at, find_largest_face, track_face

Array = NDArray[np.float64]

NONE = np.zeros((0, 4))


def faces(*squares: tuple[float, float, float]) -> Array:
    """Boxes `(k, 4)` px of middles and sides."""
    return np.array([(x - side / 2, y - side / 2, side, side) for x, y, side in squares]).reshape(-1, 4)


def test_a_person_goes_on_whatever_the_order() -> None:
    random = np.random.default_rng(0)
    found, truth = [], []
    for step in range(20):
        order = random.permutation(2)
        both = faces((100 + 3 * step, 80, 60), (300 - 2 * step, 90, 55))
        found.append(both[order])
        truth.append(int(np.flatnonzero(order == 0)[0]))
    for picture in (0, 7, 19):
        assert track_face(found, (picture, truth[picture])) == truth
    assert track_face(found, (3, 1 - truth[3])) == [1 - one for one in truth]


def test_a_person_who_is_not_found_is_nobody_else() -> None:
    own, other = (100.0, 80.0, 60.0), (300.0, 80.0, 60.0)
    small = (110.0, 90.0, 30.0)
    found = [faces(own, other), faces(other), NONE, faces(small, other), faces(other, own)]
    assert track_face(found, (0, 0)) == [0, None, None, None, 1]
    assert track_face(found, (4, 1)) == [0, None, None, None, 1]


def test_the_largest_is_not_a_false_one() -> None:
    own, other, false = (100.0, 80.0, 60.0), (300.0, 80.0, 50.0), (200.0, 200.0, 120.0)
    found = [faces(other, own), faces(false, own, other), NONE, faces(own, other), faces(other)]
    picture, face = find_largest_face(found)
    np.testing.assert_array_equal(found[picture][face], faces(own)[0])
    with pytest.raises(ValueError, match="faces: got none in 2 images"):
        find_largest_face([NONE, NONE])


def test_the_face_that_is_pointed_at() -> None:
    found = [NONE, faces((100, 80, 60), (300, 80, 40)), faces((300, 80, 40))]
    assert find_face_at(found, faces((280, 100, 80))[0]) == (1, 1)
    assert find_face_at(found, faces((130, 60, 20))[0]) == (1, 0)
    with pytest.raises(ValueError, match="faces: got none in 1 images"):
        find_face_at([NONE], faces((0, 0, 1))[0])


def test_the_density_of_others_counts_them() -> None:
    found = [faces((100, 80, 60), (300, 90, 50)), faces((300, 90, 50)), faces((305, 90, 50), (100, 80, 60))]
    others = OtherFaces.learned(found, [0, None, 1])
    assert others.pictures == 2
    np.testing.assert_allclose(others.places, [[300, 90], [305, 90]])
    grid = np.stack(np.meshgrid(np.arange(100.0, 500), np.arange(-110.0, 290)), -1).reshape(-1, 2)
    density = others.density(grid)
    assert density.sum() == pytest.approx(1, abs=1e-6)  # one a picture
    assert np.abs(grid[density.argmax()] - (302.5, 90)).max() <= 1
    alone = OtherFaces.learned([faces((100, 80, 60))], [0])
    np.testing.assert_array_equal(alone.density(grid[:5]), 0)


def test_of_two_people_the_one_with_hands_is_meant() -> None:
    """A larger face without hands, as on a screen, is another's; without any hands it is the person's."""

    def learned(hands: bool) -> float:
        images, boxes = [], faces((420, 80, 70), (150, 90, 45))
        for k in range(12):
            image = np.full((300, 560, 3), (170, 150, 120), np.uint8)
            for x, y, side in ((420, 80, 70), (150, 90, 45)):
                cv2.ellipse(
                    image, (x, y), (round(0.4 * side), round(0.6 * side)), 0, 0, 360, (90, 130, 200), -1
                )
                cv2.rectangle(image, (x - side, y + side), (x + side, 299), (60, 120, 40), -1)
            for x in (110, 190) if hands else ():
                cv2.circle(image, (x + 15 * (k % 3), 170 + 6 * k), 17, (90, 130, 200), -1)
            images.append(image)
        return BodyParts.learned(images, lambda frame: boxes).head_height

    assert learned(hands=True) == pytest.approx(HEAD_OF_BOX * 45)
    assert learned(hands=False) == pytest.approx(HEAD_OF_BOX * 70)
