"""Where experts begin their search: apart about the last pose, or all over the picture."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...models.face.morphable_model import MorphableModel
from ...models.face.pose import Poses
from ...models.numerics.rotations import exponential

Array = NDArray[np.float64]

FARTHEST_AHEAD = 1.5
"""Share of an expert's last motion, up to which experts begin their search ahead."""

ASIDE = 0.5
"""How far they begin it aside, in standard deviations of the motion."""

STRAIGHT = 0.25
"""Share of the experts that do not."""

STEP = 0.3
"""Distance between places that are tried for a lost object, in its sizes."""

SIZES = (0.8, 1.0, 1.25)
TURNS = (-0.35, 0.0, 0.35)
"""rad about the upright axis, against the pose that it was last seen in."""

AT_ONCE = 2000
"""Poses that are tried at once, which bounds the memory."""


def apart(poses: Poses, motion: Array, walk: Array, random: np.random.Generator) -> Poses:
    """Poses from which experts begin, so that not all of them take a wrong mode for the right one.

    They go on by different shares of their last motion, and most of them step aside, too. What they believe
    is not touched by it: all climb on the same likelihood and prior, each from a place of its own.

    Parameters
    ----------
    poses
        of the experts in the picture before.
    motion
        `(n, dimension)`: how each would have moved until now, had it gone on.
    walk
        `(dimension,)` variances of the motion.
    random
        to draw from; it is moved on.
    """
    n, dimension = motion.shape
    share = np.linspace(0.0, FARTHEST_AHEAD, n)[random.permutation(n)]
    aside = ASIDE * np.sqrt(walk) * random.standard_normal((n, dimension))
    aside[random.random(n) < STRAIGHT] = 0.0
    return poses.moved(share[:, None] * motion + aside)


def likely_places(
    misfit: Callable[[Poses], Array], size: tuple[int, int], last: Poses, middle: Array, n: int
) -> Poses:
    """The `n` poses, of a grid of places, sizes and turns, whose coarse texture fits the picture best.

    Parameters
    ----------
    misfit
        of poses, `(n,)`, infinite where nothing of them is in the picture.
    size
        `(height, width)` px of the picture.
    last
        the pose in which it was seen last, which gives turns and shape.
    middle
        `(2,)` px of the object in that pose.
    n
        how many.
    """
    height, width = size
    step = STEP * float(last.sizes[0])
    columns, rows = np.arange(step / 2, width, step), np.arange(step / 2, height, step)
    grid = np.stack(np.meshgrid(columns, rows, SIZES, TURNS, indexing="ij"), axis=-1).reshape(-1, 4)
    centre = middle - last.translations[0]
    turns = exponential(grid[:, 3:] * np.array([0.0, 1.0, 0.0]))
    tried = Poses(
        turns @ last.rotations[0],
        grid[:, :2] - centre * grid[:, 2:3],
        last.morphs * grid[:, 2:3],
    )
    parts = [misfit(tried[first : first + AT_ONCE]) for first in range(0, len(tried), AT_ONCE)]
    return tried[np.argsort(np.concatenate(parts), kind="stable")[:n]]


def brought_to(model: MorphableModel, last: Poses, shown: Poses) -> Poses:
    """One pose turned in the picture's plane, scaled and moved to where others have the object, `n` poses."""
    angle = np.zeros((len(shown), 3))
    angle[:, 2] = rolls(shown) - rolls(last)
    ratio = shown.sizes[:, None] / last.sizes
    there = Poses(exponential(angle) @ last.rotations[0], np.zeros((len(shown), 2)), ratio * last.morphs)
    off = model.project(shown).mean(axis=1) - model.project(there).mean(axis=1)
    return replace(there, translations=off)


def rolls(poses: Poses) -> Array:
    """`(n,)` rad by which poses lean clockwise in the picture."""
    turns = poses.rotations
    return np.asarray(
        np.arctan2(turns[:, 1, 0] - turns[:, 0, 1], turns[:, 0, 0] + turns[:, 1, 1]), np.float64
    )
