"""What stands in a scene and what has gone from it: told apart by outlines in image and picture."""

import numpy as np
import pytest
from rsmcm.chains.objects import blob_scene
from rsmcm.chains.objects.blob_records import box_of, length_of
from rsmcm.chains.objects.blob_scene import MOST_EVIDENCE, Learning, outline_evidence, weigh
from rsmcm.chains.objects.blobs import Blob, Blobs
from rsmcm.models.pixels.background import StoredPlanes

F4 = np.float32
SIZE = (60, 50)
OBJECT = np.s_[14:44, 18:32]


def pair(seed, contrast, noise, texture=6.0):
    """An empty scene as it is remembered, and the same with an object and noise; three planes each."""
    random = np.random.default_rng(seed)
    coarse = random.normal(0, texture, (3, SIZE[0] // 3 + 1, SIZE[1] // 3 + 1))
    scene = 110 + coarse.repeat(3, axis=1).repeat(3, axis=2)[:, : SIZE[0], : SIZE[1]]
    shown = scene.copy()
    shown[:, *OBJECT] = 110 + contrast * np.array([1, 0.5, -0.5])[:, None, None]
    shown += random.normal(0, noise, shown.shape)
    return scene.astype(F4), shown.astype(F4)


def evidence(image, picture, free=1):
    open_ = np.full(SIZE, free, F4)
    behind = StoredPlanes(picture, F4(1))
    return outline_evidence(image, 0, 0, behind, open_, outline(), (0, 0, *SIZE), np.empty(100_000, F4))


def outline():
    mask = np.zeros(SIZE, F4)
    mask[OBJECT] = 0.9
    return mask


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0, 4, 10])
def test_a_thing_before_the_scene_is_real_and_one_in_the_picture_is_a_ghost(seed, noise):
    empty, with_object = pair(seed, 60, noise)
    assert evidence(with_object, empty) < -60
    noisy = empty + np.random.default_rng(9).normal(0, noise, empty.shape).astype(F4)
    assert evidence(noisy, pair(seed, 60, 0)[1]) > 60


@pytest.mark.parametrize("noise", [0, 4, 10])
def test_without_contrast_on_either_side_nothing_is_said(noise):
    """Neither the noise of the image, which the picture does not have, nor texture is an edge."""
    found = []
    for seed in range(40):
        scene, _ = pair(seed, 0, 0)
        image = scene + np.random.default_rng([seed, 1]).normal(0, noise, scene.shape).astype(F4)
        found.append(evidence(image, scene))
    assert abs(np.mean(found)) < 3
    assert np.abs(found).max() < 30


def test_the_ratio_turns_round_with_image_and_picture():
    empty, with_object = pair(3, 40, 0)
    there = evidence(with_object, empty)
    assert evidence(empty, with_object) == pytest.approx(-there)


def test_an_outline_that_others_hide_tells_nothing():
    empty, with_object = pair(3, 40, 0)
    assert evidence(with_object, empty, free=0) == 0


def rule(elapsed):
    names = dict.fromkeys(Learning._fields, 0.0)
    return Learning(**{**names, "elapsed": elapsed, "view_share": -np.expm1(-elapsed / blob_scene.VIEW_TIME)})


def moving(speed, origin_x):
    blob = Blob.newborn(1, np.zeros(2), outline(), np.zeros((3, *SIZE), F4), 2.0, 300.0)
    return blob.changed(velocity=np.array([0.0, speed]), origin=(origin_x, 14.0, 10.0, 30.0))


def looked_at(blob, image, picture, frames, elapsed=0.04):
    blobs = Blobs.of([blob], 3)
    (record,) = blobs.table
    for _ in range(frames):
        found = 0.15 * evidence(image, picture)
        weigh(record, found, box_of(record), length_of(record), rule(elapsed))
    return blobs[0]


def known(blob):
    (evidence,) = Blobs.of([blob], 3).ghost_evidence
    return evidence


def test_what_has_come_from_elsewhere_is_real_for_good_and_what_appeared_here_may_be_a_ghost():
    empty, with_object = pair(3, 60, 4)
    walked = looked_at(moving(30, 200.0), with_object, empty, 50)
    assert walked.past_views == -MOST_EVIDENCE
    stood = looked_at(walked.changed(velocity=np.zeros(2)), with_object, empty, 250)
    assert stood.past_views == -MOST_EVIDENCE
    # a few frames with the wrong outline change little, and many do not add up beyond what one view is worth
    wrong = looked_at(stood, empty, with_object, 3)
    assert known(wrong) < -15
    single = 0.15 * evidence(empty, with_object)
    assert known(looked_at(wrong, empty, with_object, 500)) == pytest.approx(single - 20, abs=0.1)
    appeared = looked_at(moving(0, 18.0), empty, with_object, 500)
    assert known(appeared) == pytest.approx(single, abs=0.1)
    assert single > 5
    assert looked_at(moving(30, 18.0), with_object, empty, 50).past_views == 0


def test_a_view_is_a_function_of_time():
    empty, with_object = pair(3, 60, 4)
    slow = looked_at(moving(0, 18.0), empty, with_object, 1, elapsed=0.4)
    assert looked_at(moving(0, 18.0), empty, with_object, 10).view == pytest.approx(slow.view)


def test_a_newborn_that_touches_somebody_is_as_likely_as_not_a_part_of_them():
    walker = moving(30, 200.0).changed(past_views=-16.0)
    beside = moving(0, 18.0).changed(position=np.array([0.0, 18.0]))
    assert blob_scene.inherited(beside, Blobs.of([walker], 3)) == -8
    assert blob_scene.inherited(beside.changed(position=np.array([0.0, 60.0])), Blobs.of([walker], 3)) == 0
    assert blob_scene.inherited(beside, Blobs.none(3)) == 0
