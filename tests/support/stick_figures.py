"""Markers on people who bend, reach and stretch before a camera that goes round them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rsmcm.models.numerics.rotations import exponential

Numbers = NDArray[np.float64]


class Limb(NamedTuple):
    """From the end of another limb, with the markers about it."""

    parent: int
    bone: tuple[float, float, float]
    markers: int
    freedom: float


LIMBS = (
    Limb(-1, (0.0, 0.0, 0.0), 5, 0.05),  # pelvis
    Limb(0, (0.0, -0.28, 0.0), 3, 0.12),  # belly
    Limb(1, (0.0, -0.28, 0.0), 5, 0.12),  # chest
    Limb(2, (0.0, -0.22, 0.0), 4, 0.15),  # head
    Limb(2, (0.2, 0.28, 0.0), 3, 0.4),  # upper arms
    Limb(2, (-0.2, 0.28, 0.0), 3, 0.4),
    Limb(4, (0.0, 0.26, 0.0), 3, 0.3),  # forearms
    Limb(5, (0.0, 0.26, 0.0), 3, 0.3),
    Limb(0, (0.1, 0.42, 0.0), 3, 0.18),  # thighs
    Limb(0, (-0.1, 0.42, 0.0), 3, 0.18),
    Limb(8, (0.0, 0.42, 0.0), 3, 0.15),  # shins
    Limb(9, (0.0, 0.42, 0.0), 3, 0.15),
)
"""A person of about 1.7 m with 41 markers; y points down."""
MARKER_SPREAD = 0.06
STEP = np.radians(5)
"""By which the camera goes on from frame to frame."""


def stick_figure(n_frames: int, seed: int) -> Numbers:
    """`(n_frames, 41, 3)` m in the camera's axes, orthographic: x and y are the film."""
    random = np.random.default_rng(seed)
    time = np.linspace(0, 1, n_frames)
    # few movements, of which every joint takes its part: as people have
    n_movements = 4
    cycles = random.uniform(0.7, 3.0, n_movements)
    phases = random.uniform(0, 2 * np.pi, n_movements)
    movements = np.sin(2 * np.pi * cycles * time[:, None] + phases)
    ends, turns, markers = [], [], []
    for limb in LIMBS:
        share = limb.freedom * random.standard_normal((n_movements, 3)) / np.sqrt(2)
        own = exponential(movements @ share + 0.3 * limb.freedom * random.standard_normal(3))
        root = limb.parent < 0
        turn = own if root else turns[limb.parent] @ own
        begin = np.zeros((n_frames, 3)) if root else ends[limb.parent]
        bone = np.array(limb.bone)
        along = random.uniform(0, 1, (limb.markers, 1))
        local = along * bone + MARKER_SPREAD * random.standard_normal((limb.markers, 3))
        markers.append(begin[:, None] + local @ turn.transpose(0, 2, 1))
        ends.append(begin + turn @ bone)
        turns.append(turn)
    person = np.concatenate(markers, axis=1)
    tilt = exponential(np.array([[0.25, 0.0, 0.0]]))
    around = exponential(np.outer(np.arange(n_frames) * STEP, [0.0, 1.0, 0.0]))
    return person @ (tilt @ around).transpose(0, 2, 1)
