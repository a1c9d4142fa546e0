"""Learning of blobs: shape and colours, and ghosts, which are known by their outlines."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.chains.objects import blob_scene
from rsmcm.chains.objects.blob_records import UNKNOWN_COLOUR, Patch, box_of, length_of
from rsmcm.chains.objects.blob_scene import MOST_EVIDENCE, Learning, outline_evidence, weigh
from rsmcm.chains.objects.blobs import Blob, Blobs
from rsmcm.models.pixels.background import StoredPlanes
from scipy import ndimage

from ...support.blob_patches import F4, density_of, sprite, textured


@pytest.mark.parametrize(("channels", "columns"), [(1, 16), (3, 5), (3, 33)])
def test_learn(channels, columns):
    rng = np.random.default_rng(4)
    shape = (12, columns)
    planes, appearance = (textured(rng, channels, *shape) for _ in range(2))
    appearance = (planes + 0.1 * (appearance - planes)).astype(F4)
    odds, free = rng.normal(0, 3, shape).astype(F4), rng.integers(0, 2, shape).astype(F4)
    others, mask = rng.uniform(1, 40, shape).astype(F4), rng.uniform(0, 0.95, shape).astype(F4)
    new_mask, new_appearance = np.empty_like(mask), np.empty_like(appearance)
    total, visible, seen, variance = blob_scene.learn(
        Patch(planes, odds, free), others, sprite(mask, appearance), F4(10), F4(0.2), F4(0.3),
        F4(0.45), new_mask, new_appearance, np.empty(mask.size, F4),
    )  # fmt: skip
    share = np.minimum((10 * free * mask * density_of(planes, appearance) + 1) / others, 1)
    target = share / (1 + np.exp(odds))
    assert total == pytest.approx(mask.sum(), rel=1e-4)
    assert visible == pytest.approx((free * mask).sum(), rel=1e-4)
    assert seen == pytest.approx((free * mask * target).sum(), rel=1e-3)
    learned = free * target > 0.5
    squares = np.square(planes.astype(float) - appearance).mean(axis=0)
    assert variance == pytest.approx(squares[learned & (mask > 0.5)].mean(), rel=1e-3)
    doubt = (mask > 0.35) & (density_of(planes, appearance) > 1)
    wanted = np.where(doubt, np.maximum(target, 0.45), target)
    after = np.clip(mask + 0.2 * free * (wanted - mask), 0, 0.97)
    np.testing.assert_allclose(new_mask, after, atol=1e-3)
    rate = np.where(learned, np.where(mask < 0.2, 1.0, 0.3), 0.0)
    sure = (np.abs(free * target - 0.5) > 1e-3) & (np.abs(after - 0.1) > 1e-3)
    expected = np.where(after < 0.1, UNKNOWN_COLOUR, appearance + rate * (planes - appearance))
    np.testing.assert_allclose(new_appearance[:, sure], expected[:, sure], atol=1e-2)
    assert 0 < learned.mean() < 1


@pytest.mark.parametrize(("width", "reach"), [(6, 1), (2, 2), (1, 3)])
def test_contrasts_across_an_outline_and_beside_it(width, reach):
    mask, out, within = np.zeros((30, 40), F4), np.empty((4, 4 * 1200), F4), (11, 16, 22, 24)
    mask[12:20, 17 : 17 + width] = 1
    planes = np.full((2, 30, 40), 50, F4)
    planes[:, mask > 0] = [[150], [90]]
    free = np.ones((30, 40), F4)
    picture = np.random.default_rng(0).uniform(0, 255, (2, 50, 60)).astype(F4)

    def contrasts(open_):
        picture[:, 7:37, 5:45] = planes[:, :, ::-1]
        behind = StoredPlanes(picture, F4(1))
        count = blob_scene.outline_contrasts(planes, 7, 5, behind, open_, mask, within, reach, out)
        # in the second picture all is the other way round
        other, behind = np.empty_like(out), StoredPlanes(planes, F4(1))
        turned = (planes[:, :, ::-1].copy(), 0, 0, behind, open_, mask, within, reach, other)
        assert blob_scene.outline_contrasts(*turned) == count
        np.testing.assert_array_equal(out[2:, :count], other[:2, :count])
        np.testing.assert_array_equal(out[:2, :count], other[2:, :count])
        return count

    count = contrasts(free)
    assert count == 2 * (8 + width)
    np.testing.assert_allclose(out[0, :count], np.hypot(100, 40))
    np.testing.assert_array_equal(out[1, :count], 0)
    planes[:] = 3 * np.arange(40)
    assert contrasts(free) == count
    slopes = np.unique(out[1, :count])
    np.testing.assert_allclose(slopes, [0, 6 * reach * np.sqrt(2)], rtol=1e-6)
    free[:, :17] = 0  # what covers the left side hides its outline, and places above and below next to it
    assert contrasts(free) == count - 8
    assert contrasts(0 * free) == 0


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


@pytest.mark.parametrize(("seed", "noise"), [(0, 0), (1, 4), (2, 10)])
def test_a_thing_before_the_scene_is_real_and_one_in_the_picture_is_a_ghost(seed, noise):
    empty, with_object = pair(seed, 60, noise)
    assert evidence(with_object, empty) < -60
    assert evidence(with_object, empty, free=0) == 0  # others hide the outline
    noisy = empty + np.random.default_rng(9).normal(0, noise, empty.shape).astype(F4)
    assert evidence(noisy, pair(seed, 60, 0)[1]) > 60


@pytest.mark.parametrize("noise", [0, 10])
def test_without_contrast_on_either_side_nothing_is_said(noise):
    """Neither the noise of the image, which the picture does not have, nor texture is an edge."""
    found = []
    for seed in range(20):
        scene, _ = pair(seed, 0, 0)
        image = scene + np.random.default_rng([seed, 1]).normal(0, noise, scene.shape).astype(F4)
        found.append(evidence(image, scene))
    assert abs(np.mean(found)) < 4 * np.std(found) / len(found) ** 0.5 + 0.5  # standard errors
    assert np.abs(found).max() < 30


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
    assert known(looked_at(wrong, empty, with_object, 500)) == pytest.approx(min(single, 20) - 20, abs=0.1)
    appeared = looked_at(moving(0, 18.0), empty, with_object, 500)
    assert known(appeared) == pytest.approx(min(single, 20), abs=0.1)
    assert single > 5
    assert looked_at(moving(30, 18.0), with_object, empty, 50).past_views == 0


def test_a_newborn_that_touches_somebody_is_as_likely_as_not_a_part_of_them():
    walker = moving(30, 200.0).changed(past_views=-16.0)
    beside = moving(0, 18.0).changed(position=np.array([0.0, 18.0]))
    assert blob_scene.inherited_evidence(beside, Blobs.of([walker], 3)) == -8
    assert (
        blob_scene.inherited_evidence(beside.changed(position=np.array([0.0, 60.0])), Blobs.of([walker], 3))
        == 0
    )
    assert blob_scene.inherited_evidence(beside, Blobs.none(3)) == 0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([(40, 60), (33, 65), (210, 390)]), st.booleans())
def test_spots_are_connected_blocks_off_the_blobs(seed, size, has_blob):
    random, scale = np.random.default_rng(seed), 2 if size[1] > 200 else 1
    log_odds = np.where(random.random(size) < 0.12, -5, 5).astype(np.int8)
    log_odds[5:17, 20:31] = -9
    blob = moving(0, 18.0).changed(position=np.array([-4.0, 9.0]))
    blobs = Blobs.of([blob] if has_blob else [], 3)
    rows, columns = (-(-side // scale) for side in size)
    counts, beside = np.zeros((rows, columns)), np.zeros((rows, columns), bool)
    for y, x in np.argwhere(log_odds < 0) // scale:
        counts[y, x] += 1
    for y, x in (np.argwhere(blob.mask > 0.2) + blob.corner) // scale if has_blob else ():
        if 0 <= y < rows and 0 <= x < columns:
            beside[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2] = True
    counts[beside] = 0
    labels, _ = ndimage.label(counts >= scale**2 / 4, np.ones((3, 3)))
    expected = []
    for number, (down, across) in enumerate(ndimage.find_objects(labels), 1):
        spot = [down.start, across.start, down.stop, across.stop]
        length = scale * max(down.stop - down.start, across.stop - across.start)
        if counts[labels == number].sum() >= max(8, 0.08 * length**2):
            expected.append([scale * each for each in spot])
    found = blob_scene.find_spots(log_odds, blobs, 8)
    assert sorted(found) == sorted(expected)
    assert [spot[0] for spot in found] == sorted(spot[0] for spot in found)
