"""What notebooks show of beliefs and models."""

from xml.etree import ElementTree

import cv2
import numpy as np
from numpy.typing import NDArray
from rsmcm.chains import AdaptiveBackground
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import BodyParts, ObjectBoxes, PixelLabels, PointTracks
from rsmcm.models.body.parts import PartMessage
from rsmcm.models.core.gaussian_message import GaussianMessage
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures
from rsmcm.models.objects.box_message import BoxMessage
from rsmcm.models.points.point_tracks import PointMessage


def blank() -> NDArray[np.uint8]:
    return np.zeros((60, 80, 3), np.uint8)


def test_a_belief_tints_what_is_foreground() -> None:
    empty = np.full((60, 80), 100, np.uint8)
    shown = empty.copy()
    shown[20:40, 30:50] = 250
    engine = RecursiveBP(MultiChain().connect(AdaptiveBackground(), PixelLabels()))
    *_, belief = engine.run([*[empty] * 20, shown])
    encoded = belief._repr_png_()
    assert encoded is not None
    picture = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    red = picture[..., 2].astype(int) - picture[..., 0]
    assert red[30, 40] > 50
    assert abs(red[5, 5]) < 10


def test_points_boxes_and_parts_are_drawn_where_they_are() -> None:
    place, spread = np.array([[40.0, 30.0]]), 4 * np.eye(2)[None]
    picture = blank()
    PointTracks().draw(picture, PointMessage(GaussianMessage.from_moments([3], place, spread)))
    assert picture[30, 40].any()
    assert not picture[:15].any()

    picture = blank()
    box = GaussianMessage.from_moments([1], [[40.0, 50.0, 20.0, 30.0]], np.eye(4)[None])
    ObjectBoxes().draw(picture, BoxMessage(box))
    assert picture[20:51, 30].all(axis=0).any()
    assert not picture[:, :25].any()

    picture = blank()
    means = np.array([[40.0, 12.0], [20.0, 40.0], [60.0, 40.0]])
    parts = GaussianMixtures.of_parts(
        [np.zeros(1)] * 3, list(means[:, None]), [spread] * 3, [-np.inf] * 3, [np.zeros(1, np.int64)] * 3
    )
    BodyParts(head_height=20.0).draw(picture, PartMessage(parts))
    for x, y in means.astype(int):
        assert picture[y, x].any()


def test_a_model_shows_its_graph() -> None:
    model = MultiChain().connect(AdaptiveBackground(), PixelLabels())
    assert ElementTree.fromstring(model._repr_svg_()).tag.endswith("svg")
