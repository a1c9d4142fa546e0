"""Points of a generated signer as a detector would find them: with errors, misses, and sides exchanged."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.scenes import SignerScene
from rsmcm.models import GivenKeypoints
from rsmcm.models.body.upper_body import UpperBody
from rsmcm.models.core.frame import KEYPOINTS

Array = NDArray[np.float64]

MIRRORED = [
    KEYPOINTS.index({"left": "right", "right": "left"}.get(side, side) + bar + kind)
    for side, bar, kind in (name.partition("_") for name in KEYPOINTS)
]
WRISTS = [KEYPOINTS.index(f"{side}_wrist") for side in ("left", "right")]
HANDS = [KEYPOINTS.index(f"{side}_hand") for side in ("left", "right")]
ELBOWS = [KEYPOINTS.index(f"{side}_elbow") for side in ("left", "right")]


def points_of(joints: Array, body: UpperBody) -> Array:
    """`(n, 10, 2)` px: all `KEYPOINTS` of joints `(n, 8, 2)`, the wrists before the hands' centres."""
    elbows, hands = joints[:, ELBOWS], joints[:, HANDS]
    wrists = hands - body.hand / body.forearm * (hands - elbows)
    return np.concatenate([joints, wrists], axis=1)


def read_frame_result(
    scene: SignerScene,
    *,
    noise: float = 0.08,
    missed: float = 0.15,
    false: float = 0.05,
    exchanged: float = 0.05,
    shift: tuple[float, float] = (0.0, 0.0),
) -> Iterator[GivenKeypoints]:
    """What a detector of wrists finds in the frames of a scene, of one person.

    Parameters
    ----------
    noise
        standard deviation of points, head heights.
    missed, false
        chances of each point that is not found, and of one that is up to two head heights off.
    exchanged
        chance that all sides are, in a frame.
    shift
        px: of all of it.
    """
    random = np.random.default_rng([scene.seed, 77])
    unit = scene.body.head_height
    for points in points_of(scene.joints[..., :2], scene.body):
        places = points + noise * unit * random.standard_normal(points.shape) + shift
        if random.random() < exchanged:
            places = places[MIRRORED]
        wrong = random.random(len(places)) < false
        places[wrong] += unit * random.uniform(-2, 2, (int(wrong.sum()), 2))
        places[random.random(len(places)) < missed] = np.nan
        places[HANDS] = np.nan
        yield GivenKeypoints(places[None], np.where(np.isnan(places[:, 0]), 0.0, 0.9)[None])


def write_csv(path: Path, found: list[GivenKeypoints], first: int = 1) -> Path:
    """A file of the points of the frames from the `first` on."""
    lines = ["frame,person,joint,x,y,score"]
    for number, given in enumerate(found, start=first):
        for person, (places, scores) in enumerate(zip(given.positions, given.scores, strict=True)):
            lines += [
                f"{number},{person},{name},{x:.3f},{y:.3f},{score}"
                for name, (x, y), score in zip(KEYPOINTS, places, scores, strict=True)
                if score > 0
            ]
    path.write_text("\n".join(lines) + "\n")
    return path
