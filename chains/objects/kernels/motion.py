"""How blobs move on while nobody looks, and which of them are pieces of one."""

import numpy as np

from ....models.numerics.compiled import compiled
from .records import FRESH, box_of, length_of


@compiled
def move(blobs, dt, noise, acceleration, detected_acceleration):
    """Places and velocities `dt` s on, in place: velocity stays, but for a random force of own lengths/s^2.

    `noise` `(2, 2)` is the covariance of the step for a density of 1 (see `kalman.kinematic`).
    """
    for k in range(blobs.size):
        blob = blobs[k]
        force = (detected_acceleration if blob.detected else acceleration) * length_of(blob)
        density = 0.5 * force * force  # px^2/s^3
        blob.position[0] += dt * blob.velocity[0]
        blob.position[1] += dt * blob.velocity[1]
        place, both, speed = blob.covariance[0, 0], blob.covariance[0, 1], blob.covariance[1, 1]
        blob.covariance[0, 0] = place + 2 * dt * both + dt * dt * speed + density * noise[0, 0]
        blob.covariance[0, 1] = blob.covariance[1, 0] = both + dt * speed + density * noise[0, 1]
        blob.covariance[1, 1] = speed + density * noise[1, 1]


@compiled
def _are_pieces(one, other):
    """Whether two blobs, the second seen for no longer, are parts of one object.

    What touches a blob right after it was born belongs to it if it is above, below or small, and the two
    together are not much larger than the larger (or the first is as new); so do blobs that have stood still
    above each other for a while, or that move alike above each other and make one upright body together. What
    a detector has found is whole.
    """
    if one.detected and other.detected:
        return False
    x, y, width, height = box_of(one)
    other_x, other_y, other_width, other_height = box_of(other)
    gap_y = max(y, other_y) - min(y + height, other_y + other_height)
    gap_x = max(x, other_x) - min(x + width, other_x + other_width)
    if max(gap_x, gap_y) > 3:
        return False
    wide = max(x + width, other_x + other_width) - min(x, other_x)
    tall = max(y + height, other_y + other_height) - min(y, other_y)
    stacked = -gap_x > 0.7 * min(width, other_width)
    if other.seen >= FRESH:
        apart = np.hypot(one.velocity[0] - other.velocity[0], one.velocity[1] - other.velocity[1])
        one_body = -gap_y < 0.2 * min(height, other_height) and tall < 3.2 * wide and apart < 0.2 * tall
        return stacked and (one_body or min(one.still, other.still) > 1.5)
    modest = tall < 1.6 * max(height, other_height) and wide < 1.6 * max(width, other_width)
    larger = max(width * height, other_width * other_height)
    small = min(width * height, other_width * other_height) < 0.35 * larger
    return (stacked or small) and (one.seen < FRESH or modest)


@compiled
def next_piece(blobs, first):
    """The first blob from `first` on that is a piece of one before it, and that one; how many, if none is."""
    for k in range(first, blobs.size):
        for j in range(k):
            if _are_pieces(blobs[j], blobs[k]):
                return k, j
    return blobs.size, blobs.size
