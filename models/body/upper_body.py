"""The upper body of a person: poses, lengths of segments, joints and their limits, how arms reach."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Positive, Shape, checked
from ..core.short_repr import Rows, short_repr
from ..numerics.rotations import logarithm
from .kernels import elbows, place_joints, place_parts, reach, within_limits

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ANGLES = 16  # degrees of freedom: 2 of the root, 3 of torso and neck each, 3 of a shoulder, 1 of an elbow


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class BodyPoses(Rows):
    """Array of poses of an upper body with 16 degrees of freedom (13 in RSMCM paper §4.1).

    x is to the right, y down and z away from the viewer; "left" is the person's own. The elbow is a hinge, so
    the directions of upper arm and forearm determine all four angles of an arm, without jumps. All rotations
    are in the axes of the image, not of the torso: people who lean keep their head upright and their hands in
    place.

    Parameters
    ----------
    roots
        `(n, 2)` px: the point between the shoulders.
    torsos
        `(n, 3)` rad: rotation vectors of the torso about the root; x leans it forwards, y turns its left
        shoulder to the viewer, z leans it to its left. 0 is upright and faces the camera.
    necks
        `(n, 3)` rad: rotation vectors of the head about the root.
    arms
        `(n, 2, 2, 3)`: unit vectors along the upper arm and the forearm, [left, right][upper arm, forearm].
    """

    roots: Annotated[Array, Shape("n", 2)]
    torsos: Annotated[Array, Shape("n", 3)]
    necks: Annotated[Array, Shape("n", 3)]
    arms: Annotated[Array, Shape("n", 2, 2, 3)]

    def __len__(self) -> int:
        return len(self.roots)

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """Roots, torsos, necks and arms."""
        return self.roots, self.torsos, self.necks, self.arms

    @classmethod
    def concatenated(cls, parts: Sequence[Self]) -> Self:
        """Concatenate poses."""
        return parts[0].joined(parts[1:])

    def take(self, chosen: Any) -> Self:
        """Select poses by a slice, a mask or indices."""
        if isinstance(chosen, slice):
            return self.only(chosen)
        rows = np.asarray(chosen)
        if rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        # `take` is several times faster than `[rows]`
        return self.made(each.take(rows, 0) for each in self.arrays)

    def replaced(self, where: NDArray[np.bool_], others: "BodyPoses") -> Self:
        """Replace the poses `where` `(n,)` by those of `others`."""
        pairs = zip(self.arrays, others.arrays, strict=True)
        return self.made(np.where(where.reshape(-1, *[1] * (own.ndim - 1)), new, own) for own, new in pairs)

    def with_rows(self, rows: NDArray[np.intp], others: "BodyPoses") -> Self:
        """Replace the poses `rows` `(k,)` by k `others`."""
        changed = self.made(each.copy() for each in self.arrays)
        for own, new in zip(changed.arrays, others.arrays, strict=True):
            own[rows] = new
        return changed

    @property
    def turns(self) -> Array:
        """`(n, 6)` rad: rotation vectors of torso and neck."""
        return np.concatenate([self.torsos, self.necks], axis=1)

    @property
    def angles(self) -> Array:
        """`(n, 16)`: root, torso, neck, of each arm rotation vector of the shoulder and flexion of the elbow.

        With a shoulder at zero the arm hangs; the elbow bends the forearm towards the viewer. A straight arm
        has the twist of `transport`.
        """
        rotations, flexions = shoulder_rotations(self.arms)
        n = len(self)
        angles = np.empty((n, ANGLES))
        angles[:, :2], angles[:, 2:8] = self.roots, self.turns
        per_arm = angles[:, 8:].reshape(n, 2, 4)
        per_arm[:, :, :3] = logarithm(rotations.reshape(2 * n, 3, 3)).reshape(n, 2, 3)
        per_arm[:, :, 3] = flexions
        return angles


def shoulder_rotations(arms: Array) -> tuple[Array, Array]:
    """Return rotations of shoulders and flexions of elbows of `arms` `(..., 2, 3)` [upper arm, forearm].

    Returns `rotations` `(..., 3, 3)`: their second column is the upper arm, their first the elbow's axis;
    `flexions` `(...)` rad, from 0 (straight) to pi.
    """
    upper, forearm = arms[..., 0, :], arms[..., 1, :]
    axis = np.cross(forearm, upper)
    sine = np.sqrt((axis**2).sum(-1))
    flexions = np.arctan2(sine, (upper * forearm).sum(-1))
    straight = sine < 1e-12
    axis = axis / np.where(straight, 1.0, sine)[..., None]
    if straight.any():
        axis[straight] = transport(upper[straight])[..., 0]
    return np.stack([axis, upper, np.cross(axis, upper)], axis=-1), flexions


def transport(upper: Array) -> Array:
    """`(..., 3, 3)`: the smallest rotations from a hanging arm (0, 1, 0) to `upper` `(..., 3)`."""
    x, y, z = upper[..., 0], upper[..., 1], upper[..., 2]
    square = x * x + z * z
    turned_over = (square < 1e-28) & (y < 0)
    # 1 / (1 + y), which loses its digits near the top, where it equals (1 - y) / (1 - y^2)
    below = (1 - y) / np.maximum(square, 1e-28)
    shrink = np.where(y < 0, below, 1 / np.maximum(1 + y, 0.5))
    rotations = np.empty((*upper.shape, 3))
    rotations[..., 0, 0], rotations[..., 1, 0], rotations[..., 2, 0] = 1 - x * x * shrink, -x, -x * z * shrink
    rotations[..., :, 1] = upper
    rotations[..., 0, 2], rotations[..., 1, 2], rotations[..., 2, 2] = -x * z * shrink, -z, 1 - z * z * shrink
    rotations[turned_over] = np.diag([1.0, -1.0, -1.0])
    return rotations


_LENGTH_STD = 0.15  # of log lengths of people about the usual proportions
_NOISE = 0.03  # head heights: usual error of a joint along a segment, known to a factor of two
_WRONG = 0.05  # share of outliers


def projected_length(apparent: Array, usual: float, noise: float) -> float:
    """Estimate the length (px) of a segment from its projected lengths `apparent` `(n,)` px.

    At the angle a to the line of sight it appears L sin(a) long, plus normal errors. Angles are uniform:
    arms point to the viewer more often than random directions do. The density peaks just below L, so a few
    images suffice. Priors: length about `usual` px, errors about `noise` px.
    """
    from scipy.optimize import minimize

    sines = np.sin((np.arange(96) + 0.5) * (np.pi / 2 / 96))

    def misfit(logs: Array) -> float:
        length, deviation = np.exp(logs)
        # narrower than the grid of angles, and the sum would no longer be the integral
        deviation = np.hypot(deviation, 0.015 * length)
        distance = (apparent[:, None] - length * sines) / deviation
        density = np.exp(-0.5 * distance**2).mean(1) / (np.sqrt(2 * np.pi) * deviation)
        likelihood = np.log((1 - _WRONG) * density + _WRONG / (3 * usual)).sum()
        # heavy tails (Student's t, three degrees of freedom): many observations outweigh the prior
        prior = -2 * np.log1p(((logs[0] - np.log(usual)) / _LENGTH_STD) ** 2 / 3)
        prior -= 0.5 * ((logs[1] - np.log(noise)) / np.log(2)) ** 2
        return float(-prior - likelihood)

    starts = (usual, float(np.quantile(apparent, 0.85)) + 1e-9)
    found = [
        minimize(misfit, np.log([start, noise]), method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-4})
        for start in starts
    ]
    best = min(found, key=lambda result: float(result.fun))
    return float(np.exp(best.x[0]))


def _apparent(first: Array, second: Array) -> Array:
    """Distances between `(n, 2)` px, where both are known."""
    distance: Array = np.hypot(*(first - second).T)
    known: Array = distance[~np.isnan(distance)]
    return known


def _head_height(seen: dict[str, Array], head_heights: Array | None) -> float:
    """Height of the head: given, or by usual proportions from the most reliable segment."""
    given = np.array([] if head_heights is None else head_heights, np.float64).ravel()
    given = given[~np.isnan(given)]
    known = [(given, 0.5, 1.0)]
    for name, quantile in (("neck", 0.5), ("shoulder_width", 0.5), ("upper_arm", 0.85), ("forearm", 0.85)):
        known.append((seen[name], quantile, PROPORTIONS[name]))
    for lengths, quantile, share in known:
        if len(lengths):
            height = float(np.quantile(lengths, quantile) / share)
            if not (np.isfinite(height) and height > 0):
                raise ValueError(f"joints: got a head of {height:g} px, expected a positive height")
            return height
    raise ValueError(
        "joints: got no length, expected both ends of a segment in one image, or a head's height"
    )


PARTS = ("head", "left_hand", "right_hand")  # parts that have features of their own in the picture

JOINTS = (
    "head", "neck", "left_shoulder", "left_elbow", "left_hand", "right_shoulder", "right_elbow", "right_hand",
)  # fmt: skip
"""Points of the kinematic tree; "neck" is its root, between the shoulders; hands and head are centres."""

PART_JOINTS = [JOINTS.index(part) for part in PARTS]


@dataclass(frozen=True)
class JointLimits:
    """Limits of the joints, in rad, of the left arm; those of the right one are mirrored.

    They are wide, to exclude impossible poses only. Limits of head and arms are in the torso's axes.
    """

    torso: float = np.radians(45)  # largest rotation of the torso, from upright
    neck: float = np.radians(50)  # largest rotation of the head against the torso
    # middle of the cone in which the left upper arm points (outwards, down, towards the viewer), not of unit
    # length, and the largest angle from it: not far across the back nor the chest
    swing_centre: tuple[float, float, float] = (0.35, 0.6, -0.6)
    swing: float = np.radians(105)
    # least (external) and greatest (internal) turn of the upper arm about its own axis, from `transport`: 0
    # bends the elbow of a hanging arm towards the viewer, pi/2 across the belly
    outwards: float = np.radians(-100)
    inwards: float = np.radians(100)
    elbow: float = 2.6  # greatest flexion: muscles meet
    # flexion below which the turn of the upper arm is undetermined, and not tested
    straight: float = 0.15

    @cached_property
    def numbers(self) -> Array:
        """`(10,)`: the limits for `within_limits`."""
        centre = np.array(self.swing_centre) / np.linalg.norm(self.swing_centre)
        middle, half = 0.5 * (self.inwards + self.outwards), 0.5 * (self.inwards - self.outwards)
        bends = np.cos([self.elbow, self.straight])
        return np.array([self.torso, np.cos(self.neck), *centre, np.cos(self.swing), middle, half, *bends])


LIMITS = JointLimits()


@checked
@short_repr
@dataclass(frozen=True)
class UpperBody:
    """Lengths and widths of an upper body, all in px.

    Parameters
    ----------
    head_height, head_width
        chin to top of the skull, and across.
    neck
        root (between the shoulder joints) to the centre of the head.
    shoulder_width
        from one shoulder joint to the other.
    upper_arm, forearm
        shoulder to elbow; elbow to the centre of the hand.
    hand
        radius.
    upper_arm_width, forearm_width, wrist_width
        across the arm at the shoulder, at the elbow and at the wrist.
    torso_height, torso_width
        root to the lap or the waist, where the torso ends, and across there.

    Raises
    ------
    ValueError
        for a length that is not positive, or more than four times off the proportions.
    """

    head_height: Positive
    head_width: Positive
    neck: Positive
    shoulder_width: Positive
    upper_arm: Positive
    forearm: Positive
    hand: Positive
    upper_arm_width: Positive
    forearm_width: Positive
    wrist_width: Positive
    torso_height: Positive
    torso_width: Positive

    def __post_init__(self) -> None:
        for field in fields(self):
            length = getattr(self, field.name)
            usual = PROPORTIONS.get(field.name, 1.0) * self.head_height
            if not usual / 4 < length < 4 * usual:
                raise ValueError(
                    f"{field.name}: got {length:g} px beside a head of {self.head_height:g} px, "
                    f"expected about {usual:.3g} px"
                )

    @classmethod
    @checked
    def from_head(cls, head_height: Positive) -> Self:
        """Return a body of average proportions with a head of `head_height` px, chin to top of the skull."""
        lengths = {name: float(share * head_height) for name, share in PROPORTIONS.items()}
        return cls(head_height=float(head_height), **lengths)

    @classmethod
    @checked
    def fit(
        cls,
        joints: Annotated[Array, Shape("n_frames", 8, 2, finite=False)],
        head_heights: Array | None = None,
    ) -> Self:
        """Fit a body to joints in a few images; unknown lengths have average proportions.

        Shoulders and neck mostly face the camera, so medians are taken: with typical turns of 17 degrees the
        shoulders are 2 % too narrow. Arms point anywhere, see `projected_length`. Left and right have equal
        lengths.

        Parameters
        ----------
        joints
            `(n_frames, 8, 2)` px: the `JOINTS` in each image, NaN where unknown.
        head_heights
            `(n_frames,)` px, chin to top of the skull, NaN where unknown; `None`: from the joints.

        Raises
        ------
        ValueError
            if the joints have another shape, or give no length or an impossible one.
        """
        joints = np.asarray(joints, np.float64)
        if np.isinf(joints).any():
            raise ValueError("joints: got infinity, expected px, or NaN where a joint is not seen")
        head, root, left, left_elbow, left_hand, right, right_elbow, right_hand = joints.transpose(1, 0, 2)
        root = np.where(np.isnan(root), (left + right) / 2, root)
        seen = {
            "neck": _apparent(head, root),
            "shoulder_width": np.concatenate(
                [_apparent(left, right), 2 * _apparent(left, root), 2 * _apparent(right, root)]
            ),
            "upper_arm": np.concatenate([_apparent(left, left_elbow), _apparent(right, right_elbow)]),
            "forearm": np.concatenate([_apparent(left_elbow, left_hand), _apparent(right_elbow, right_hand)]),
        }
        height = _head_height(seen, head_heights)
        lengths = {name: share * height for name, share in PROPORTIONS.items()}
        lengths["head_height"] = height
        for name in ("neck", "shoulder_width"):
            if len(seen[name]):
                lengths[name] = float(np.median(seen[name]))
        for name in ("upper_arm", "forearm"):
            if len(seen[name]):
                lengths[name] = projected_length(seen[name], lengths[name], _NOISE * height)
        lengths["torso_width"] *= lengths["shoulder_width"] / (PROPORTIONS["shoulder_width"] * height)
        return cls(**lengths)

    def joints(self, poses: BodyPoses) -> Array:
        """`(n, 8, 3)` px: positions of the `JOINTS`; z is 0 at the root and grows away from the viewer."""
        joints = np.empty((len(poses), 8, 3))
        place_joints(
            *poses.arrays,
            self.neck, self.shoulder_width / 2, self.upper_arm, self.forearm, joints,
        )  # fmt: skip
        return joints

    def parts(self, poses: BodyPoses) -> Array:
        """`(n, 3, 2)` px: head, left hand and right hand in the image."""
        parts = np.empty((len(poses), 3, 2))
        place_parts(
            *poses.arrays,
            self.neck, self.shoulder_width / 2, self.upper_arm, self.forearm, parts,
        )  # fmt: skip
        return parts

    def shoulders(self, poses: BodyPoses) -> Array:
        """`(n, 2, 3)` px: left and right shoulder, as in `joints`."""
        return self.joints(poses).take([2, 5], 1)

    def allowed(self, poses: BodyPoses) -> Mask:
        """`(n,)`: whether every joint is within its limits and no arm is in or behind the torso."""
        allowed = np.empty(len(poses), np.bool_)
        within_limits(poses.torsos, poses.necks, poses.arms, *self.limits, allowed)
        return allowed

    @cached_property
    def limits(self) -> tuple[float, float, float, Array, Array]:
        """Half the shoulders' width, lengths of the arm, limits and torso, as `within_limits` takes them."""
        torso = np.array([self.shoulder_width, self.torso_width, self.torso_height, 0.45 * self.head_height])
        return self.shoulder_width / 2, self.upper_arm, self.forearm, LIMITS.numbers, torso


PROPORTIONS = {
    "head_width": 0.72,
    "neck": 0.89,
    "shoulder_width": 1.45,
    "upper_arm": 1.4,
    "forearm": 1.5,
    "hand": 0.3,
    "upper_arm_width": 0.45,
    "forearm_width": 0.36,
    "wrist_width": 0.25,
    "torso_height": 2.0,
    "torso_width": 1.25,
}
"""Lengths of an average body over the height of its head."""


REFERENCE = np.array([0.7, -0.7, 0.1]) / np.sqrt(0.99)
"""Direction of swivel 0 of the left elbow: outwards and up, where hands seldom are."""


def arm_at(body: "UpperBody", side: int, offsets: Array, swivels: Array) -> tuple[Array, Mask]:
    """Solve the inverse kinematics of arms by the law of cosines.

    `side`: 0 for the left arm, 1 for the right one; `offsets` `(n, 3)` px: hand minus shoulder; `swivels`
    `(n,)` rad: angle of the elbow on its circle, from the direction nearest to `REFERENCE`; mirrored arms
    have equal swivels. Returns `arms` `(n, 2, 3)`: unit vectors along upper arm and forearm; `reachable`
    `(n,)`: whether hands reach there; other arms are stretched, or folded, along the line to it.
    """
    arms, reachable = np.empty((len(offsets), 2, 3)), np.empty(len(offsets), np.bool_)
    reach(
        np.ascontiguousarray(offsets), np.ascontiguousarray(swivels),
        body.upper_arm, body.forearm, 1.0 - 2.0 * side, REFERENCE, arms, reachable,
    )  # fmt: skip
    return arms, reachable


def swivels(side: int, arms: Array, body: "UpperBody") -> Array:
    """`(n,)` rad from -pi to pi: swivels, as `arm_at` takes them, of `arms` `(n, 2, 3)`."""
    upright, level = np.empty((2, len(arms)))
    sign = 1.0 - 2.0 * side
    elbows(np.ascontiguousarray(arms), body.upper_arm, body.forearm, sign, REFERENCE, upright, level)
    angles: Array = np.arctan2(upright, level)
    return angles


def log_volume(body: "UpperBody", offsets: Array) -> Array:
    """`(n,)`: log of r L1 L2 for hands at `offsets` `(n, 3)` px from their shoulders, r their distance.

    d(hand x, y, z) d(swivel) = r L1 L2 d(upper arm) d(forearm), where the directions have areas on unit
    spheres and L1, L2 are the lengths: a density over directions is that over places times r L1 L2.
    """
    squares = np.maximum(np.einsum("nx,nx->n", offsets, offsets), np.finfo(np.float64).tiny)
    volume: Array = 0.5 * np.log(squares) + np.log(body.upper_arm * body.forearm)
    return volume
