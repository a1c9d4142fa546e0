"""Objects as supervision takes them."""

import numpy as np
import supervision
from rsmcm.apps.exports import to_supervision
from rsmcm.apps.exports.coco import object_masks
from rsmcm.apps.io.tracks import TrackedBox
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels


def test_a_belief_becomes_detections() -> None:
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
    film = sleeping_man(40, size=(128, 96), enter=5, car_leaves=20)
    *_, belief = RecursiveBP(model).run(film)
    tracks, foreground = belief["blobs"].tracks(), belief[pixels].foreground()
    found = to_supervision(tracks, foreground)
    assert isinstance(found, supervision.Detections)
    assert len(found) == len(tracks) > 0
    boxes = np.array([track.box for track in tracks])
    np.testing.assert_allclose(supervision.xyxy_to_xywh(found.xyxy), boxes)
    np.testing.assert_array_equal(found.mask, object_masks(foreground, boxes))
    assert found.tracker_id is not None
    assert found.tracker_id.tolist() == [track.identity for track in tracks]
    assert found.confidence is not None
    assert found.confidence.tolist() == [track.confidence for track in tracks]
    np.testing.assert_array_equal(found.data["velocity"], [track.velocity for track in tracks])
    np.testing.assert_array_equal(found.data["covariance"], [track.position_covariance for track in tracks])
    assert found.data["seen"].tolist() == [track.seen for track in tracks]
    moving = found[np.hypot(*found.data["velocity"].T) > 1]
    assert len(moving.data["covariance"]) == len(moving)


def test_no_object_is_no_detection() -> None:
    found = to_supervision([], np.zeros((9, 12), np.uint8))
    assert len(found) == 0
    assert found.is_empty()
    assert to_supervision([TrackedBox(1, (0, 0, 2, 3))]).mask is None
