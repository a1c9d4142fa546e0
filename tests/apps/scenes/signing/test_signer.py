"""The synthetic signer: exact truth, faults as often as asked for, pictures that show what the truth says."""

import numpy as np
import pytest
from rsmcm.apps.scenes import signer
from rsmcm.apps.scenes.signing.faults import BOX_NOISE, FACE_BELOW, FACE_BOX, MISSING, bursts, false_skin
from rsmcm.apps.scenes.signing.shape import tube
from rsmcm.models.core.frame import Frame

HANDS = (4, 7)  # of JOINTS
SEEDS = range(5)


# Truth


@pytest.mark.parametrize("seed", SEEDS)
def test_poses_are_within_limits_and_in_the_picture(seed):
    scene = signer(120, seed)
    assert scene.body.allowed(scene.poses).all()
    assert len(scene.poses) == 120
    assert scene.joints.shape == (120, 8, 3)
    np.testing.assert_array_equal(scene.joints, scene.body.joints(scene.poses))
    np.testing.assert_allclose(np.linalg.norm(scene.poses.arms, axis=-1), 1, atol=1e-12)
    inside = (scene.joints[..., :2] > 0) & (scene.joints[..., :2] < np.array(scene.size) - 1)
    assert inside.all(axis=-1).mean() > 0.99
    assert inside[:, [0, *HANDS]].all()
    assert 0.2 * 360 < scene.body.head_height < 0.28 * 360


def test_hands_do_not_pass_through_head_or_each_other():
    for seed in SEEDS:
        scene = signer(120, seed)
        body, joints = scene.body, scene.joints
        half = np.array([body.head_width, body.head_height, 0.9 * body.head_height]) / 2
        away = (joints[:, HANDS] - joints[:, :1]) / half
        assert (np.linalg.norm(away, axis=-1) > 1).all()
        apart = np.linalg.norm(joints[:, HANDS[0]] - joints[:, HANDS[1]], axis=-1)
        # a hand that waits for a possible way may be touched
        assert np.quantile(apart, 0.05) > 0.8 * body.hand
        assert apart.min() > 0.5 * body.hand


def test_scenes_differ_and_longer_ones_begin_like_shorter_ones():
    short, long, other = signer(20, 3), signer(45, 3), signer(20, 4)
    np.testing.assert_array_equal(short.poses.angles, long.poses.angles[:20])
    np.testing.assert_array_equal(short.hidden, long.hidden[:20])
    for index in (0, 19):
        np.testing.assert_array_equal(short.image(index), long.image(index))
    for mine, theirs in zip(short.detector.boxes, long.detector.boxes, strict=False):
        np.testing.assert_array_equal(mine, theirs)
    assert short.body != other.body
    assert not np.array_equal(short.image(0), other.image(0))


# Faults


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 0.9])
def test_features_are_missing_in_bursts_as_often_as_asked_for(share):
    scene = signer(6000, 2, detector_dropout=share)
    np.testing.assert_allclose(scene.hidden.mean(axis=0), share, atol=0.025)
    # each part on its own
    together = (scene.hidden[:, 1] & scene.hidden[:, 2]).mean()
    assert together == pytest.approx(share**2, abs=0.03)
    numbers = bursts(6000, share, MISSING, np.random.default_rng(1))
    lengths = np.bincount(numbers)[1:-1]
    assert lengths.min() >= (MISSING[0] if share < 0.8 else 1)  # short pauses vanish, then bursts overlap
    assert lengths.max() <= MISSING[1]


def test_detector_finds_the_face_unless_it_is_hidden():
    scene = signer(1000, 3, clutter=0.0)
    boxes = [scene.detector(Frame(np.zeros((360, 640, 3), np.uint8), 0.0, k + 1)) for k in range(1000)]
    np.testing.assert_array_equal([len(found) == 0 for found in boxes], scene.hidden[:, 0])
    seen = ~scene.hidden[:, 0]
    found = np.concatenate(boxes)
    side = FACE_BOX * scene.body.head_height
    centres = found[:, :2] + found[:, 2:] / 2
    errors = np.column_stack(
        [centres - scene.joints[seen, 0, :2] - [0, FACE_BELOW * side], found[:, 2] - side]
    )
    n = len(found)
    np.testing.assert_allclose(errors.mean(axis=0) / side, 0, atol=4 * BOX_NOISE / np.sqrt(n))
    np.testing.assert_allclose(errors.std(axis=0) / side, BOX_NOISE, rtol=4 / np.sqrt(2 * n))


def test_detector_of_another_scene_and_of_no_picture():
    detector = signer(5, 1).detector
    with pytest.raises(ValueError, match="frame 6, expected one of its own scene, 1 to 5"):
        detector(Frame(np.zeros((360, 640, 3), np.uint8), 0.0, 6))
    assert detector(Frame(None, 0.0, 1)).shape == (0, 4)


def test_false_skin_comes_as_often_as_asked_for():
    """Bursts of 12 frames on the mean, deviation 5, and pauses with one of 0.29 of their mean."""
    assert signer(200, 1, clutter=0.0).distractors == ()
    n_frames, size, head = 20_000, (640, 360), 80.0
    for clutter in (0.5, 2.0):
        there, share = np.zeros(n_frames, bool), 0.15 * clutter
        for thing in false_skin(np.full((n_frames, 2), 150.0), head, size, clutter, 1):
            there[thing.first : thing.last + 1] = True
            assert ((thing.start > 0) & (thing.start < size)).all()
            assert 0.1 < thing.radius / head < 0.35
        cycle, pause = 12 / share, 12 * (1 - share) / share
        variance = ((1 - share) * 5) ** 2 + (share * 0.29 * pause) ** 2  # of a burst's share of its cycle
        assert there.mean() == pytest.approx(share, abs=5 * np.sqrt(variance / (cycle * n_frames)))


# Pictures


def test_a_tube_has_rings_of_the_stated_half_widths() -> None:
    centres = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])
    across, over = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    wide, deep = np.array([2.0, 2.0, 1.0]), np.array([0.5, 1.0, 1.0])
    places = tube("skin", centres, across, over, wide, deep).places.reshape(3, -1, 3)
    x, y = places[..., 0] / wide[:, None], places[..., 1] / deep[:, None]
    np.testing.assert_allclose(x**2 + y**2, 1, atol=1e-12)
    np.testing.assert_allclose(places[..., 2], centres[:, 2:].repeat(places.shape[1], axis=1))
