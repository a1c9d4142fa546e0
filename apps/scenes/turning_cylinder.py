"""A cylinder of points that turns before a camera, and the partial tracks that a poor tracker makes of it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import Count, CountFrom0, NotNegative, between, checked
from ...models.core.short_repr import short_repr

TILT = 30.0  # degrees by which the camera looks down on the upright axis: points then move in u and in v
DRIFT = 0.1  # length of the bias that stands for template drift, in radii of the cylinder
DRIFT_FRAMES = 5  # frames that it lasts


@short_repr
@dataclass(frozen=True, eq=False)
class Cylinder:
    """Points on a rotating cylinder, with their observations; build it with `cylinder`.

    Lengths are in radii of the cylinder, u points right, v down.

    Parameters
    ----------
    shape
        `(n_points, 3)`: radius 1, height -1..1 along the third axis, the axis of rotation.
    cameras
        `(n_frames, 2, 4)`: affine cameras, orthographic, their rows orthonormal;
        position = `cameras[t, :, :3] @ shape[i] + cameras[t, :, 3]`.
    positions
        `(n_frames, n_points, 2)` of all points, without noise and drift.
    visible
        `(n_frames, n_points)` bool.
    observed
        `(n_frames, n_points, 2)` with noise and drift; NaN where invisible.
    drifting
        `(n_frames, n_points)` bool: whether `observed` has a bias.
    seed
        from which all this was drawn.
    """

    shape: NDArray[np.float64]
    cameras: NDArray[np.float64]
    positions: NDArray[np.float64]
    visible: NDArray[np.bool_]
    observed: NDArray[np.float64]
    drifting: NDArray[np.bool_]
    seed: int

    def tracks(self) -> NDArray[np.float64]:
        """Return partial tracks, `(n_frames, n_tracks, 2)`, NaN without an observation.

        Every interval in which a point is visible without a gap is a track. The tracks are in random order.
        """
        frames = np.arange(len(self.visible))[:, None]
        inside = (frames >= self._stretches[:, 1]) & (frames < self._stretches[:, 2])
        return np.where(inside[:, :, None], self.observed[:, self.point_of_track], np.nan)

    @property
    def point_of_track(self) -> NDArray[np.int64]:
        """True point of each track, `(n_tracks,)`."""
        return self._stretches[:, 0]

    @cached_property
    def _stretches(self) -> NDArray[np.int64]:
        """Point, first frame and frame after the last of every track, `(n_tracks, 3)`, in random order."""
        hidden = np.zeros((1, self.visible.shape[1]), np.int8)
        steps = np.diff(self.visible.astype(np.int8), axis=0, prepend=hidden, append=hidden).T
        points, starts = np.nonzero(steps == 1)
        _, ends = np.nonzero(steps == -1)
        stretches = np.stack([points, starts, ends], axis=1)
        return np.random.default_rng([self.seed, 1]).permutation(stretches, axis=0)


Chance = Annotated[float, between(0, 1)]


@checked
def cylinder(
    n_points: Count = 40,
    n_frames: Count = 60,
    p_loose: Chance = 0.1,
    p_drift: Chance = 0.3,
    p_regain: Chance = 0.5,
    seed: CountFrom0 = 0,
    *,
    degrees_per_frame: float = 3.0,
    noise: NotNegative = 0.01,
) -> Cylinder:
    """Make the synthetic sequence of the RSMCM paper, section 4.3 (Figs. 9 and 10).

    The paper does not specify that: the cylinder is transparent, so that its far side is visible too; all
    points are visible in the first frame; a bias ends when its point is lost, and a point has one bias at a
    time. Sequences of one seed share shape, noise and uniform random numbers.

    Parameters
    ----------
    n_points, n_frames
        how many.
    p_loose
        probability that a visible point is lost in a frame.
    p_drift
        probability that in a visible point without bias a bias of `DRIFT` in a random direction begins,
        which lasts `DRIFT_FRAMES` frames.
    p_regain
        probability that a lost point is found again in a frame.
    seed
        of all random numbers.
    degrees_per_frame
        angular velocity.
    noise
        standard deviation of each observed coordinate, in radii.

    Raises
    ------
    ValueError
        if a probability lies outside 0..1, or there is no point or frame.
    """
    generator = np.random.default_rng(seed)
    around = generator.uniform(0, 2 * np.pi, n_points)
    shape = np.stack([np.cos(around), np.sin(around), generator.uniform(-1, 1, n_points)], axis=1)
    errors = noise * generator.standard_normal((n_frames, n_points, 2))
    chance = generator.random((n_frames, n_points))
    drift_chance = generator.random((n_frames, n_points))
    direction = generator.uniform(0, 2 * np.pi, (n_frames, n_points))

    cameras = _cameras(np.radians(degrees_per_frame) * np.arange(n_frames))
    positions = np.einsum("tka,ia->tik", cameras[:, :, :3], shape) + cameras[:, None, :, 3]
    visible = np.ones((n_frames, n_points), np.bool_)
    for t in range(1, n_frames):
        visible[t] = np.where(visible[t - 1], chance[t] >= p_loose, chance[t] < p_regain)
    bias = _drift(visible, drift_chance < p_drift, direction)
    observed = np.where(visible[:, :, None], positions + errors + bias, np.nan)
    drifting = np.linalg.norm(bias, axis=2) > 0
    return Cylinder(shape, cameras, positions, visible, observed, drifting, seed)


def _cameras(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cameras `(n_frames, 2, 4)` before which the cylinder has turned by `angles` radians."""
    tilt = np.radians(TILT)
    cosine, sine = np.cos(angles), np.sin(angles)
    cameras = np.zeros((len(angles), 2, 4))
    cameras[:, 0, 0], cameras[:, 0, 1] = cosine, -sine
    cameras[:, 1, 0], cameras[:, 1, 1] = -np.sin(tilt) * sine, -np.sin(tilt) * cosine
    cameras[:, 1, 2] = -np.cos(tilt)  # up on the cylinder is less v
    return cameras


def _drift(
    visible: NDArray[np.bool_], begins: NDArray[np.bool_], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The bias `(n_frames, n_points, 2)`; it begins where `begins` says so, in `direction` radians."""
    n_frames, n_points = visible.shape
    bias = np.zeros((n_frames, n_points, 2))
    current = np.zeros((n_points, 2))
    left = np.zeros(n_points, np.int64)  # frames that it still lasts
    for t in range(n_frames):
        left[~visible[t]] = 0
        new = begins[t] & visible[t] & (left == 0)
        left[new] = DRIFT_FRAMES
        current[new] = DRIFT * np.stack([np.cos(direction[t, new]), np.sin(direction[t, new])], axis=1)
        bias[t] = np.where(left[:, None] > 0, current, 0.0)
        left = np.maximum(left - 1, 0)
    return bias
