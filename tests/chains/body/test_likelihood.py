"""The body's likelihood against plain numpy, in pictures whose truth is known, and where a cue is missing."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains.body.kernels.image import (
    FOREARM_POINTS,
    NECK,
    arm_terms,
    forearm_terms,
    hand_terms,
    unexplained_terms,
)
from rsmcm.chains.body.likelihood import (
    ARM_POINTS,
    ARM_WEIGHTS,
    BARE_HAND_SCORES,
    BARE_POINTS,
    BARE_SCORES,
    EDGE_POINTS,
    EDGE_SHARPNESS,
    EDGE_STD,
    EDGE_WINDOW,
    HEAD_SCORES,
    NECK_RADIUS,
    NO_EDGE,
    NO_SLEEVE,
    SKIN_SCORES,
    TRUNK,
    TRUNK_BLUR,
    WINDOWS,
    BodyLikelihood,
    edge_ratios,
    hand_model,
    skin_maps,
)
from rsmcm.models.body.image_features import BodyImage, edge_distances
from rsmcm.models.body.skin import HIGHEST
from rsmcm.models.body.upper_body import BodyPoses, UpperBody
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures
from rsmcm.models.numerics.threads import set_threads, thread_count
from scipy.ndimage import map_coordinates

from ...support.body_poses import masks, silhouettes

Array = NDArray[np.float64]

SIZE = (360, 640)
BODY = UpperBody.from_head(80)
HEAD, SKIN, CLOTHES = 0, 1, 3
HANDS = (5, 8)
"""Labels of the hands in masks."""


def signing() -> BodyPoses:
    """One pose with both hands before the chest's sides, elbows out."""
    arms = np.array([[[[0.45, 0.85, -0.25], [0.1, -0.75, -0.6]], [[-0.5, 0.8, -0.3], [0.05, -0.3, -0.9]]]])
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    return BodyPoses(np.array([[310.0, 150.0]]), np.zeros((1, 3)), np.zeros((1, 3)), arms)


def seen(poses: BodyPoses, *, without: tuple[int, ...] = (), discs: Array | None = None) -> BodyImage:
    """What an image of the first of `poses` says; hands `without` skin, and `discs` more of it."""
    labels = masks(BODY, poses.take([0]), SIZE)[0]
    parts = BODY.parts(poses)[0]
    skin = np.full(SIZE, -4, np.float32)
    skin[labels == 1] = 4
    more = np.zeros((0, 2)) if discs is None else discs
    for side in (0, 1):
        if side not in without:
            skin[labels == HANDS[side]] = 4
    for x, y in more:
        cv2.circle(skin, (round(x), round(y)), round(BODY.hand), 4, -1)
    edges, directions = edge_distances((25 * labels).astype(np.uint8), BODY.head_height / 6)
    heads = parts[:1]
    spread = np.array([(0.1 * BODY.head_height) ** 2 * np.eye(2)])
    none = np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0)
    mixtures = GaussianMixtures.of_parts(
        [[np.log(0.95 * 360 * 640)], none[2], none[2]],
        [heads, none[0], none[0]],
        [spread, none[1], none[1]],
        np.log([0.05, 1, 1]),
    )
    blobs = np.concatenate([parts[[1 + side for side in (0, 1) if side not in without]], more])
    return BodyImage(edges.shape, skin, skin, edges, directions, blobs, np.full(len(blobs), 1.5), mixtures)


def scattered(n: int, random: np.random.Generator, spread: float = 0.3) -> BodyPoses:
    """Poses about `signing()`."""
    poses = signing().take(np.zeros(n, int))
    arms = poses.arms + spread * random.normal(size=poses.arms.shape)
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    roots = poses.roots + 30 * spread * random.normal(size=(n, 2))
    return BodyPoses(roots, np.zeros((n, 3)), 0.5 * spread * random.normal(size=(n, 3)), arms)


def hand_scores(
    image: BodyImage, parts: Array, roots: Array, elbows: Array | None = None, faces: Array | None = None
) -> Array:
    """`(n,)` as the likelihood calls it; of bare forearms, if there are elbows `(n, 2, 2)`."""
    assert image.skin is not None
    skin = skin_maps(image.skin, BODY.hand)
    scales = np.array(skin[0].shape[::-1]) / SIZE[::-1]
    out = np.zeros(len(parts))
    bare = elbows is not None
    elbows = np.zeros((len(parts), 2, 2)) if elbows is None else elbows
    nats = np.empty((len(parts), 2))
    hand = hand_model(BODY, bare=bare, heads_and_necks=faces)
    hand_terms(parts, roots, elbows, *skin, scales, hand, bare, out, nats)
    return out


# --- the kernels against plain numpy ------------------------------------------------------------------------


def plain_strip(places: Array, start: Array, end: Array, spread: float) -> Array:
    """Share of a window that a forearm covers, from the elbow to the wrist."""
    along = end - start
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    half = 0.25 * (BODY.forearm_width + BODY.wrist_width)
    off = places - start
    t, across = (off * along).sum(1), off[:, 1] * along[:, 0] - off[:, 0] * along[:, 1]

    def before(edge: Array) -> Array:
        share: Array = 1 / (1 + np.exp(-1.7 * edge / spread))
        return share

    wrist = np.maximum(length - BODY.hand, 0)
    share: Array = (before(wrist - t) - before(-t)) * (before(half - across) - before(-half - across))
    return share


def look_up_colours(one: NDArray[np.float32], places: Array) -> Array:
    where = (places + 0.5) * np.array(one.shape[::-1]) / SIZE[::-1] - 0.5
    values = cv2.remap(
        one, where[:, None].astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(values[:, 0], np.float64)


def within(places: Array, spread: float) -> Array:
    """`(n,)`: share of a window at `places` `(n, 2)` px that is in the picture."""
    edge = np.concatenate([places + 0.5, np.array(SIZE[::-1]) - 0.5 - places], axis=1).min(axis=1)
    share: Array = 1 / (1 + np.exp(np.clip(-1.7 * edge / spread, -60, 60)))
    return share


def plain_hands(image: BodyImage, parts: Array, roots: Array, elbows: Array | None = None) -> Array:
    assert image.skin is not None
    maps = skin_maps(image.skin, BODY.hand)
    full, none, hidden = SKIN_SCORES if elbows is None else BARE_HAND_SCORES
    r, inner, outer = BODY.hand, *(BODY.hand * np.array(WINDOWS))
    half = 0.5 * np.array([BODY.head_width, BODY.head_height])
    big, small = np.sqrt(half.prod()), NECK_RADIUS * BODY.head_height
    ideal = np.exp(-0.5 * (r / outer) ** 2) - np.exp(-0.5 * (r / inner) ** 2)
    apart = np.linalg.norm(parts[:, 1] - parts[:, 2], axis=1)
    width = outer**2 + r**2 / 4
    neighbour = 0.5 * r**2 / width * np.exp(-0.5 * apart**2 / width)
    neck = parts[:, 0] + NECK * (roots - parts[:, 0])
    gains = []
    for side in (1, 2):
        places = parts[:, side]
        from_head = np.linalg.norm((places - parts[:, 0]) / half, axis=1) * big
        from_neck = np.linalg.norm(places - neck, axis=1)

        def covered(window: float, from_head: Array = from_head, from_neck: Array = from_neck) -> Array:
            share = [
                1 / (1 + np.exp(1.7 * (d - s) / window)) for d, s in ((from_head, big), (from_neck, small))
            ]
            return np.maximum(*share)

        centre, surround = (look_up_colours(one, places) for one in maps)
        before, around = covered(inner), covered(outer)
        if elbows is not None:
            around = around + sum(plain_strip(places, elbows[:, s], parts[:, 1 + s], outer) for s in (0, 1))
            other = 2 - side
            before = np.maximum(before, plain_strip(places, elbows[:, other], parts[:, 1 + other], inner))
        foreign = np.maximum(surround - neighbour - around, 0)
        response = (np.maximum(centre - before, 0) - foreign) / ideal
        free = 1 - before
        nats = within(places, inner) * (free * none + (full - none) * np.clip(response, 0, free))
        gains.append(np.log((1 - hidden) * np.exp(nats) + hidden))
    t = np.minimum(apart / (2 * r), 1)
    shared = 2 / np.pi * (np.arccos(t) - t * np.sqrt(1 - t**2))
    total: Array = gains[0] + gains[1] - np.minimum(2 * shared, 1) * np.maximum(np.minimum(*gains), 0)
    return total


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10**6))
def test_hands_equal_plain_numpy(seed: int) -> None:
    random = np.random.default_rng(seed)
    image = seen(signing())
    poses = scattered(20, random, 0.5)
    parts = BODY.parts(poses)
    parts[:5] = parts[:5, :1] + random.normal(0, 40, (5, 3, 2))  # hands at the face and at each other
    # cv2.remap interpolates with 1/32 px: 0.6 % of a map's range, times the nats of the whole range
    for elbows in (None, BODY.joints(poses)[:, [3, 6], :2]):
        np.testing.assert_allclose(
            hand_scores(image, parts, poses.roots, elbows),
            plain_hands(image, parts, poses.roots, elbows),
            atol=0.25,
        )


def test_nothing_is_known_of_a_hand_outside_of_the_picture() -> None:
    """Neither skin beyond the border nor none; within the picture, skin and its absence tell."""
    skin = np.full(SIZE, -4, np.float32)
    skin[:, :60] = 4
    image = replace(seen(signing()), skin=skin)
    places = np.array([[-90.0, 200.0], [320.0, 460.0], [320.0, 250.0]])
    parts = np.stack(
        [np.tile(BODY.parts(signing())[0, 0], (3, 1)), places, places + np.array([0.0, 70.0])], axis=1
    )
    scores = hand_scores(image, parts, np.tile(signing().roots, (3, 1)))
    np.testing.assert_allclose(scores[:2], 0, atol=0.05)
    assert scores[2] < -0.5


def test_skin_of_a_detected_face_is_no_hand() -> None:
    """Even for a pose whose head is elsewhere."""
    image, true = seen(signing(), without=(0, 1)), BODY.parts(signing())
    parts = np.stack([true[:, 0] - [150.0, 0.0], true[:, 0], true[:, 0] - [300.0, 0.0]], axis=1)
    roots = signing().roots - [150.0, 0.0]
    half = 0.5 * np.array([BODY.head_width, BODY.head_height])
    alone = hand_scores(image, parts, roots)
    assert alone > 2
    assert hand_scores(image, parts, roots, faces=np.array([[*true[0, 0], *half]])) < alone - 2


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10**6), st.integers(0, 6))
def test_unexplained_skin_equals_plain_numpy(seed: int, m: int) -> None:
    random = np.random.default_rng(seed)
    joints, places = random.uniform(0, 200, (9, 8, 2)), random.uniform(0, 200, (m, 2))
    costs, reach = random.uniform(0, 2, m), np.array([50.0, 30.0, 30.0, 20.0])
    parts, ends = joints[:, [0, 4, 7]], joints[:, [3, 4, 6, 7, 1]]
    begins = joints[:, [2, 3, 5, 6, 0]]
    begins[:, [0, 2]] = 0.5 * (begins + ends)[:, [0, 2]]
    squares = ((parts[:, None] - places[None, :, None]) ** 2).sum(-1) / reach[:3] ** 2
    # distances from limbs, by the nearest of many points on each
    t = np.linspace(0, 1, 2001)[:, None, None, None]
    points = (1 - t) * begins + t * ends
    limbs = ((points[:, :, None] - places[:, None]) ** 2).sum(-1).min(axis=0) / reach[3] ** 2
    for bare, near in ((False, squares), (True, np.concatenate([squares, limbs], axis=2))):
        out = np.zeros(9)
        unexplained_terms(joints, places, costs, reach, bare, out)
        expected = -(costs * (1 - np.exp(-0.5 * near)).prod(-1)).sum(-1)
        # exponential() is exact to 2e-5, the rest to 1e-6, points on a limb are 0.1 px apart
        np.testing.assert_allclose(out, expected, atol=2e-3)


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 10**6))
def test_forearms_equal_plain_numpy(seed: int) -> None:
    random = np.random.default_rng(seed)
    image = seen(signing(), discs=random.uniform(50, 300, (8, 2)))
    poses = scattered(20, random, 0.5)
    assert image.skin is not None
    centre = skin_maps(image.skin, BODY.hand)[0]
    joints = BODY.joints(poses)[..., :2]
    parts, elbows = joints[:, [0, 4, 7]], joints[:, [3, 6]]
    full, none, hidden = BARE_SCORES
    inner, wide = BODY.hand * WINDOWS[0], 0.25 * (BODY.forearm_width + BODY.wrist_width)
    ideal = 2 / (1 + np.exp(-1.7 * wide / inner)) - 1
    half = 0.5 * np.array([BODY.head_width, BODY.head_height])
    neck = parts[:, 0] + NECK * (poses.roots - parts[:, 0])
    expected = np.zeros(20)
    for side in (0, 1):
        along = parts[:, 1 + side] - elbows[:, side]
        projected = np.linalg.norm(along, axis=1)
        wrist = np.maximum(projected - BODY.hand, 0)
        nats = np.zeros(20)
        for share in (np.arange(FOREARM_POINTS) + 0.5) / FOREARM_POINTS:
            places = elbows[:, side] + (share * wrist / projected)[:, None] * along
            discs = [
                (
                    np.linalg.norm((places - parts[:, 0]) / half, axis=1) * np.sqrt(half.prod()),
                    half.prod() ** 0.5,
                ),
                (np.linalg.norm(places - neck, axis=1), NECK_RADIUS * BODY.head_height),
                *((np.linalg.norm(places - parts[:, hand], axis=1), BODY.hand) for hand in (1, 2)),
            ]
            covered = np.max([1 / (1 + np.exp(1.7 * (d - radius) / inner)) for d, radius in discs], axis=0)
            if side == 1:
                covered = np.maximum(covered, plain_strip(places, elbows[:, 0], parts[:, 1], inner))
            shown = np.clip(look_up_colours(centre, places) / ideal - covered, 0, 1 - covered)
            shown = within(places, inner) * ((1 - covered) * none + (full - none) * shown)
            nats += shown / FOREARM_POINTS
        nats *= wrist / (BODY.forearm - BODY.hand)
        expected += np.log((1 - hidden) * np.exp(nats) + hidden)
    out = np.zeros(20)
    scales = np.array(centre.shape[::-1]) / SIZE[::-1]
    forearm_terms(parts, poses.roots, elbows, centre, scales, hand_model(BODY), out)
    np.testing.assert_allclose(out, expected, atol=0.15)  # by cv2.remap's 1/32 px, as above


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 10**6))
def test_edges_equal_plain_numpy(seed: int) -> None:
    """At the outlines as they are traced by themselves, some of which leave the picture."""
    random = np.random.default_rng(seed)
    height, width = SIZE
    poses = scattered(6, random, 0.5)
    outline = silhouettes(BODY, poses)
    angles = random.uniform(0, np.pi, SIZE)
    ratio = random.uniform(0, 5, SIZE)
    ratios = np.stack([ratio, np.cos(2 * angles), np.sin(2 * angles)], -1).astype(np.float32)
    column, row = np.floor(outline.points + np.float32(0.5)).astype(int).transpose(2, 0, 1)
    inside = outline.visible & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    turns = np.arctan2(outline.normals[..., 1], outline.normals[..., 0])
    density = np.exp(EDGE_SHARPNESS * np.cos(2 * (turns - angles[row, column]))) / np.i0(EDGE_SHARPNESS)
    logs = np.log(NO_EDGE + (1 - NO_EDGE) * ratio[row, column] * density)
    found = replace(BodyLikelihood(BODY)(seen(signing())), edges=ratios).rest(poses)
    np.testing.assert_allclose(found, EDGE_POINTS / inside.shape[1] * (inside * logs).sum(1), atol=2e-3)


def test_values_do_not_depend_on_threads() -> None:
    random = np.random.default_rng(0)
    likelihood = BodyLikelihood(BODY)(replace(seen(signing()), bare=0.5))
    poses, before, found = scattered(1501, random, 0.3), thread_count(), []
    try:
        for threads in (1, 2, 3):
            set_threads(threads)
            found.append((likelihood.first(poses), likelihood.rest(poses)))
    finally:
        set_threads(before)
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


# --- what it says in pictures whose truth is known ----------------------------------------------------------


def plain_arms(arms: NDArray[np.float32], joints: Array, bare: float) -> Array:
    """`(n,)` nats of colours along the arms, one place after the other."""
    left, right, root = joints[:, 2], joints[:, 5], joints[:, 1]
    broad = np.linalg.norm(left - right, axis=1)
    across = (left - right) / broad[:, None]
    up = np.stack([across[:, 1], -across[:, 0]], axis=1)
    total = np.zeros(len(joints))
    for shoulder in (2, 5):
        for part in (0, 1):
            start, end = joints[:, shoulder + part], joints[:, shoulder + part + 1]
            for share, below in zip(ARM_POINTS[part], BARE_POINTS[part], strict=True):
                place = start + share * (end - start)
                beside = np.abs(((place - root) * across).sum(1)) - TRUNK[0] * broad
                above = ((place - root) * up).sum(1) - TRUNK[1] * broad
                outside = np.maximum(beside, above) / (TRUNK_BLUR * BODY.head_height)
                rows_and_columns = (0.5 * place[:, ::-1] - 0.25).T
                odds = map_coordinates(arms, rows_and_columns, order=1, mode="nearest")
                odds *= within(place, TRUNK_BLUR * BODY.head_height)
                odds /= 1 + np.exp(-np.clip(outside, -20, 20))
                weight = ARM_WEIGHTS[part] * (1 - bare if below else 1.0)
                total += weight * np.log((1 - NO_SLEEVE) * np.exp(odds) + NO_SLEEVE)
    return total


def sleeved(arms: NDArray[np.float32], bare: float = 0.0) -> BodyImage:
    """An image whose only news is the map of the sleeves' colour."""
    return replace(seen(signing()), arms=arms, bare=bare)


@pytest.mark.parametrize(("seed", "bare"), [(0, 0.0), (1, 0.3), (2, 1.0)])
def test_arms_equal_plain_numpy(seed: int, bare: float) -> None:
    """At torsos that lean and turn as well, and at places out of the picture."""
    random = np.random.default_rng(seed)
    poses = scattered(40, random)
    poses = replace(poses, torsos=0.4 * random.normal(size=(40, 3)))
    poses.roots[:10] += random.normal(0, 300, (10, 2))
    arms = cv2.GaussianBlur(random.normal(0, 8, (180, 320)).astype(np.float32), (0, 0), 3)
    found = BodyLikelihood(BODY)(sleeved(arms, bare)).inner_terms(poses)[CLOTHES]
    joints, out = BODY.joints(poses)[:, :, :2], np.full(40, 7.0)
    np.testing.assert_allclose(found, plain_arms(arms, joints, bare), rtol=1e-4, atol=1e-4)
    torso = np.array([*TRUNK, TRUNK_BLUR * BODY.head_height])
    weights = ARM_WEIGHTS[:, None] * (1 - bare * BARE_POINTS)
    arm_terms(joints, arms, np.array([0.5, 0.5]), ARM_POINTS, weights, torso, NO_SLEEVE, out)
    np.testing.assert_allclose(out, 7 + found, rtol=1e-5)


def test_a_first_look_is_all_but_edges() -> None:
    """In an image that has something to say of each of the others."""
    poses = scattered(20, np.random.default_rng(4))
    arms = np.random.default_rng(5).normal(0, 3, (180, 320)).astype(np.float32)
    likelihood = BodyLikelihood(BODY)(sleeved(arms))
    inner, edges = likelihood.inner_terms(poses), likelihood.rest(poses)
    np.testing.assert_array_equal(likelihood.first(poses), inner.sum(axis=0))
    assert np.ptp([*inner[[HEAD, SKIN, CLOTHES]], edges], axis=1).min() > 1
    np.testing.assert_array_equal(likelihood(poses), inner.sum(axis=0) + edges)


# --- where a cue is missing ---------------------------------------------------------------------------------


def test_without_a_face_the_head_is_where_its_skin_is() -> None:
    poses = BodyPoses.concatenated([signing(), scattered(200, np.random.default_rng(3), 0.8)])
    missed = replace(seen(signing()), mixtures=GaussianMixtures.uniform(3))
    term = BodyLikelihood(BODY)(missed).inner_terms(poses)[HEAD]
    off = np.linalg.norm(BODY.parts(poses)[:, 0] - BODY.parts(signing())[:, 0], axis=1) / BODY.head_height
    assert term[0] > 0.9 * HEAD_SCORES[0] + np.log(1 - HEAD_SCORES[1])
    assert np.median(term[off < 0.2]) > term[off > 0.6].max() + 1
    far = replace(signing(), roots=np.array([[80.0, 300.0]]))
    assert BodyLikelihood(BODY)(missed).inner_terms(far)[HEAD] == pytest.approx(0, abs=0.01)
    grey = BodyLikelihood(BODY)(replace(missed, skin=None, moving_skin=None)).inner_terms(poses)
    assert not grey[HEAD].any()
    assert np.isfinite(grey).all()


# --- edges --------------------------------------------------------------------------------------------------


def ratios_of(picture: NDArray[np.uint8]) -> tuple[NDArray[np.float32], BodyImage]:
    edges, directions = edge_distances(picture, BODY.head_height / 6)
    image = replace(seen(signing()), edges=edges, edge_directions=directions)
    return edge_ratios(image, EDGE_STD * BODY.head_height, EDGE_WINDOW * BODY.head_height), image


def test_edge_ratios_are_ratios_of_densities() -> None:
    """Where edges are even in place and direction, the mean of their ratio to themselves is 1."""
    random = np.random.default_rng(5)
    discs = np.full(SIZE, 60, np.uint8)
    for x, y in random.uniform((0, 0), (640, 360), (900, 2)):
        cv2.circle(discs, (round(x), round(y)), 9, int(random.choice([60, 120, 180])), -1)
    ratios, image = ratios_of(discs)
    assert ratios.shape == (*SIZE, 3)
    # a window of half a head holds some discs, whose edges are never quite even
    assert ratios[30:-30, 30:-30, 0].mean() == pytest.approx(1, abs=0.1)
    np.testing.assert_allclose(ratios[..., 1], np.cos(2 * image.edge_directions), atol=0.02)  # 256 levels
    np.testing.assert_allclose(ratios[..., 2], np.sin(2 * image.edge_directions), atol=0.02)


# --- bare forearms ------------------------------------------------------------------------------------------


def bare_armed(poses: BodyPoses) -> BodyImage:
    """What an image of the first of `poses` says, with bare forearms."""
    image = seen(poses)
    assert image.skin is not None
    joints = BODY.joints(poses)[0, :, :2]
    for elbow, hand in ((3, 4), (6, 7)):
        ends = [tuple(int(x) for x in joints[end].round()) for end in (elbow, hand)]
        cv2.line(image.skin, *ends, 4.0, round(0.5 * (BODY.forearm_width + BODY.wrist_width)))
    blobs = np.concatenate([image.blobs, joints[[3, 6]]])
    return replace(image, blobs=blobs, blob_log_weights=np.full(4, 1.5), bare=1.0)


@pytest.mark.parametrize("sleeves", [True, False])
def test_who_may_be_in_sleeves_or_not_is_a_mixture(sleeves: bool) -> None:
    poses = BodyPoses.concatenated([signing(), scattered(40, np.random.default_rng(3))])
    image = seen(signing()) if sleeves else bare_armed(signing())
    # of arms that are surely in sleeves, blobs count in place of areas
    covered, bare, either = (
        BodyLikelihood(BODY)(replace(image, bare=share)).inner_terms(poses)[SKIN]
        for share in (1e-20, 1.0, 0.3)
    )
    np.testing.assert_allclose(either, np.log(0.7 * np.exp(covered) + 0.3 * np.exp(bare)), atol=1e-6)
    assert (covered[0] > bare[0]) == sleeves


@pytest.mark.parametrize("hands", [1.0, 3.0])
def test_skin_that_nothing_explains_costs_by_its_area(hands: float) -> None:
    """Each hand's area what a hand would gain by it, far from bare arms."""
    poses = signing()
    without, image = bare_armed(poses), bare_armed(poses)
    assert image.skin is not None
    side = np.sqrt(hands * np.pi) * BODY.hand
    image.skin[20 : 20 + round(side), 20 : 20 + round(side)] = HIGHEST
    free, costly = (BodyLikelihood(BODY)(each).inner_terms(poses)[SKIN, 0] for each in (without, image))
    # places are a hand's radius apart
    assert free - costly == pytest.approx(BARE_HAND_SCORES[0] * hands, rel=0.2)


def test_a_hand_is_seen_where_its_skin_is() -> None:
    """Not without skin; of bare arms as of others."""
    both, one = (BodyLikelihood(BODY)(seen(signing(), without=hands)) for hands in ((), (1,)))
    assert both.hand_log_odds(signing()).min() > 2
    left, right = one.hand_log_odds(signing())[0]
    assert left > 2
    assert right < -1.5
    bare = BodyLikelihood(BODY)(replace(seen(signing()), bare=1.0)).hand_log_odds(signing())
    assert bare.min() > 2
    outside = replace(signing(), roots=signing().roots + np.array([800.0, 0.0]))
    assert np.all(both.hand_log_odds(outside) == -np.inf)
