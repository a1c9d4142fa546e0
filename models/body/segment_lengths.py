"""Lengths of a body's segments from joints in a few pictures, under orthographic projection."""

import numpy as np
from numpy.typing import NDArray

from .upper_body import JOINTS, PROPORTIONS

Array = NDArray[np.float64]

_SPREAD = 0.15
"""Standard deviation of log lengths of people about the usual proportions (and about a wrong head height)."""

_NOISE = 0.03
"""Usual error of a joint along a segment, over the height of the head; known to a factor of two."""

_WRONG = 0.05
"""Share of joints that are somewhere else."""


def segment_lengths(joints: Array, head_heights: Array | None = None) -> dict[str, float]:
    """Lengths for `UpperBody` from joints in pictures, see `UpperBody.fit`.

    Shoulders and neck mostly face the camera, so that their medians are taken: of somebody who turns by 17
    degrees as a rule the shoulders come out 2 % too narrow. Arms point anywhere and are seen at most as long
    as they are, see `projected_length`. Left and right have equal lengths.

    Raises
    ------
    ValueError
        if `joints` is not `(n_frames, 8, 2)`, is infinite, or tells of no length.
    """
    joints = np.asarray(joints, np.float64)
    if joints.ndim != 3 or joints.shape[1:] != (len(JOINTS), 2):
        raise ValueError(f"joints must be (n_frames, {len(JOINTS)}, 2) px, got {joints.shape}")
    if np.isinf(joints).any():
        raise ValueError("joints must be px in the picture or NaN where they are not seen, got infinity")
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
    return lengths


def projected_length(apparent: Array, usual: float, noise: float) -> float:
    """The likeliest length (px) of a segment that is seen from all sides as long as `apparent` `(n,)` px.

    At the angle a to the line of sight it is seen L sin(a) long, plus normal errors. All angles are taken as
    equally frequent; of directions at random, fewer would point to the viewer, but arms do more often than
    that. The density is greatest just below L, so that a few pictures suffice. The length is expected about
    `usual` px, the errors about `noise` px.
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
        # heavy tails (Student's t, three degrees of freedom): what is seen all the time wins in the end
        prior = -2 * np.log1p(((logs[0] - np.log(usual)) / _SPREAD) ** 2 / 3)
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
    """Distances in the picture of `(n, 2)` px, where both are known."""
    distance: Array = np.hypot(*(first - second).T)
    known: Array = distance[~np.isnan(distance)]
    return known


def _head_height(seen: dict[str, Array], head_heights: Array | None) -> float:
    """Height of the head: given, or by usual proportions from the surest segment that was seen."""
    given = np.array([] if head_heights is None else head_heights, np.float64).ravel()
    given = given[~np.isnan(given)]
    known = [(given, 0.5, 1.0)]
    for name, quantile in (("neck", 0.5), ("shoulder_width", 0.5), ("upper_arm", 0.85), ("forearm", 0.85)):
        known.append((seen[name], quantile, PROPORTIONS[name]))
    for lengths, quantile, share in known:
        if len(lengths):
            height = float(np.quantile(lengths, quantile) / share)
            if not (np.isfinite(height) and height > 0):
                raise ValueError(f"joints lead to a head of {height:g} px, expected a positive height")
            return height
    raise ValueError(
        "joints tell of no length: no picture has both ends of a segment, nor is any head's height given"
    )
