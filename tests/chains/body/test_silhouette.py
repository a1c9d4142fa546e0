"""Outlines and pictures of bodies against solids that are made of many spheres, pixel by pixel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.chains.body.likelihood import OUTLINE_PARTS
from rsmcm.models.body.upper_body import BodyPoses, UpperBody
from scipy.spatial.transform import Rotation

from ...support.body_poses import Silhouettes, masks, resting, silhouettes

Array = NDArray[np.float64]

BODY = UpperBody.from_head(90)
SIZE = (420, 560)
seeds = st.integers(0, 10**6)
LIMBS = [k for k, name in enumerate(OUTLINE_PARTS) if name.endswith("arm")]
HANDS = [k for k, name in enumerate(OUTLINE_PARTS) if name.endswith("hand")]
HEAD, TORSO = OUTLINE_PARTS.index("head"), OUTLINE_PARTS.index("torso")


def allowed_poses(n: int, seed: int) -> BodyPoses:
    random = np.random.default_rng(seed)
    arms = random.normal(size=(200 * n, 2, 2, 3))
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    turns = random.normal(size=(2, 200 * n, 3)) * [[[0.15]], [[0.25]]]
    poses = BodyPoses(np.tile([280.0, 200.0], (200 * n, 1)), turns[0], turns[1], arms)
    poses = poses.take(np.flatnonzero(BODY.allowed(poses))[:n])
    assert len(poses) == n
    return poses


def spheres(poses: BodyPoses, part: int) -> tuple[Array, Array]:
    """Centres `(k, 3)` and radii `(k,)` of spheres that fill a limb or a hand of the first pose."""
    joints = BODY.joints(poses)[0]
    shoulder = 2 if part < 5 else 5
    name = OUTLINE_PARTS[part].split("_", 1)[1]
    if name == "hand":
        return joints[shoulder + 2][None], np.array([BODY.hand])
    start, first, last = shoulder, BODY.upper_arm_width / 2, BODY.forearm_width / 2
    if name == "forearm":
        start, first, last = shoulder + 1, BODY.forearm_width / 2, BODY.wrist_width / 2
    t = np.linspace(0, 1, 401)
    centres = joints[start] + t[:, None] * (joints[start + 1] - joints[start])
    return centres, first + t * (last - first)


def fronts(poses: BodyPoses, part: int, pixels: Array) -> Array:
    """Depth of the front of a part of the first pose at `pixels` `(k, 2)`, infinite where it is not."""
    if part == HEAD:
        turn = Rotation.from_rotvec(poses.necks[0]).as_matrix()
        centre = BODY.joints(poses)[0, 0]
        axes = np.array([BODY.head_width, BODY.head_height, 0.85 * BODY.head_height]) / 2
        shape = turn @ np.diag(1 / axes**2) @ turn.T
        p = np.column_stack([pixels - centre[:2], np.zeros(len(pixels))])
        # the ellipsoid is met where a z^2 + 2 b z + c = 0
        a, b = shape[2, 2], p @ shape[2]
        c = np.einsum("ki,ij,kj->k", p, shape, p) - 1
        root = b * b - a * c
        return np.where(root > 0, centre[2] - (b + np.sqrt(np.maximum(root, 0))) / a, np.inf)
    centres, radii = spheres(poses, part)
    nearest = np.full(len(pixels), np.inf)
    for run in np.array_split(np.arange(len(radii)), 1 + len(radii) // 100):
        span = radii[run] ** 2 - ((pixels[:, None] - centres[run, :2]) ** 2).sum(-1)
        depth = np.where(span > 0, centres[run, 2] - np.sqrt(np.maximum(span, 0)), np.inf)
        nearest = np.minimum(nearest, depth.min(1))
    return nearest


def of_part(outline: Silhouettes, part: int) -> tuple[Array, Array]:
    """Points and normals of a part of the first pose."""
    mine = outline.part == part
    return outline.points[0, mine].astype(np.float64), outline.normals[0, mine].astype(np.float64)


@pytest.mark.parametrize("seed", range(2))
def test_pictures_show_the_nearest_of_all_solids(seed: int) -> None:
    poses = allowed_poses(1, seed)
    labels = masks(BODY, poses, SIZE)[0]
    rows, columns = np.mgrid[3 : SIZE[0] : 9, 5 : SIZE[1] : 9]
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    found = labels[rows, columns].ravel()
    solids = [part for part in range(len(OUTLINE_PARTS)) if part != TORSO]
    depths = np.stack([fronts(poses, part, pixels) for part in solids])
    # the torso is no union of spheres: it is tested by itself, below
    expected = np.where(np.isfinite(depths).any(0), np.array(solids)[depths.argmin(0)] + 1, 0)
    judged = found != TORSO + 1
    first, second = np.partition(depths, 1, axis=0)[:2]
    # limbs share the sphere of an elbow, and rims have a share of a pixel
    tie = np.isfinite(second) & (second - np.where(np.isfinite(first), first, 0) < 0.5)
    wrong = judged & ~tie & (found != expected)
    assert wrong.sum() <= 0.03 * (judged & (expected > 0)).sum()
    # where the torso is in front, the others are behind its plane or absent
    shown = found == TORSO + 1
    assert (depths[:, shown].min(0, initial=np.inf) > 0.09 * BODY.head_height).all()


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_outlines_of_limbs_and_hands_touch_their_spheres(seed: int) -> None:
    poses = allowed_poses(1, seed)
    outline = silhouettes(BODY, poses)
    for part in LIMBS + HANDS:
        points, normals = of_part(outline, part)
        centres, radii = spheres(poses, part)
        for distance, sign in ((0.0, 0), (0.5, 1), (-0.5, -1)):
            away = (
                np.linalg.norm(points[:, None] + distance * normals[:, None] - centres[:, :2], axis=-1)
                - radii
            )
            if sign == 0:
                np.testing.assert_allclose(away.min(1), 0, atol=0.02)
            else:
                # out of the part along the normal, and into it against it
                np.testing.assert_allclose(away.min(1), distance, atol=0.06)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_the_head_is_the_outline_of_a_turned_ellipsoid(seed: int) -> None:
    random = np.random.default_rng(seed)
    poses = resting(np.array([[280.0, 200.0]]))
    poses.necks[0] = 0.5 * random.normal(size=3)
    points, normals = of_part(silhouettes(BODY, poses), HEAD)
    surface = random.normal(size=(40000, 3))
    surface /= np.linalg.norm(surface, axis=1, keepdims=True)
    surface *= np.array([BODY.head_width, BODY.head_height, 0.85 * BODY.head_height]) / 2
    surface = BODY.joints(poses)[0, 0] + Rotation.from_rotvec(poses.necks[0]).apply(surface)
    # the outline is as far along each normal as the farthest of the surface's points
    farthest = (surface[:, :2] @ normals.T).max(0)
    np.testing.assert_allclose((points * normals).sum(1), farthest, atol=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_points_are_visible_where_the_picture_shows_their_part(seed: int) -> None:
    poses = allowed_poses(8, seed)
    outline = silhouettes(BODY, poses)
    labels = masks(BODY, poses, SIZE)
    inside = np.rint(outline.points - 1.5 * outline.normals).astype(int)
    outside = np.rint(outline.points + 1.5 * outline.normals).astype(int)
    known = np.ones(outline.visible.shape, bool)
    for place in (inside, outside):
        known &= (place >= 0).all(-1) & (place < np.array(SIZE)[::-1]).all(-1)
    pose, number = np.nonzero(known)
    shown = labels[pose, inside[pose, number, 1], inside[pose, number, 0]]
    beyond = labels[pose, outside[pose, number, 1], outside[pose, number, 0]]
    seen, own = outline.visible[pose, number], outline.part[number] + 1
    # at corners between parts, 1.5 px aside may be another part, and hidden parts may come out again
    assert (shown == own)[seen].mean() > 0.93
    assert (beyond != own)[seen].mean() > 0.97
    assert (beyond != own)[~seen].mean() > 0.97
    assert (shown != own)[~seen].mean() > 0.8


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_the_torso_is_a_plane_that_leans_and_turns(seed: int) -> None:
    """Its outline is the upright one, behind the root, turned in space; normals are across what is seen."""
    poses = allowed_poses(3, seed)
    upright = resting(poses.roots)
    flat, _ = of_part(silhouettes(BODY, upright), TORSO)
    flat -= upright.roots[0]
    turns = Rotation.from_rotvec(poses.torsos).as_matrix()
    outline = silhouettes(BODY, poses)
    mine = outline.part == TORSO
    solid = np.column_stack([flat, np.full(len(flat), 0.1 * BODY.head_height)])
    seen = poses.roots[:, None] + np.einsum("nxy,py->npx", turns, solid)[..., :2]
    np.testing.assert_allclose(outline.points[:, mine], seen, atol=1e-3)
    normals = outline.normals[:, mine]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)
    # points of one side alternate with those of the other
    along = seen[:, 2:] - seen[:, :-2]
    same = np.linalg.norm(flat[2:] - flat[:-2], axis=1) < 0.4 * BODY.head_height
    across = np.abs((along * normals[:, 2:]).sum(-1))[:, same]
    assert (across < 1e-2 * np.linalg.norm(along, axis=-1)[:, same]).all()
    outwards = (normals * (seen - seen.mean(axis=1, keepdims=True))).sum(-1)
    assert (outwards > 0).mean() > 0.9
