"""A body's part of `view.html`: skeletons over the film and in space, and how sure each joint is."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import JOINTS, PARTS
from ..drawing.boxes import css_colour
from ..view.film import Film, Row
from ..view.page import Plot, TimelineRow, View, spans_of
from .hypotheses import WORTH_SAYING
from .overlay import CHAINS, TRUNK
from .report import PART_JOINTS

SAMPLES = 12
"""Poses of the posterior that are shown of a frame."""

PER_PX = 4
"""Their places are whole numbers of this part of a px."""

GREY = "#8a929e"
"""On the page, of what is white on the pictures."""


def drawn_of(row: Mapping[str, Any], log_evidence: float, effective: float) -> Row:
    """What is drawn of a frame, from its row of `poses.npz`, and numbers about its samples."""
    covariances = row["joints_3d_covariances"]
    upper = covariances[:, *np.triu_indices(3)]
    every = len(row["samples"]) // SAMPLES
    samples = row["samples"][::every][:SAMPLES]
    nothing = row["missing"] or row["stationary"]
    return {
        "joints": np.concatenate([row["joints_3d"], upper], axis=1).astype(np.float32),
        "samples": _whole(samples),
        "second": _whole(row["hypothesis_joints"][1]),
        "secondWeight": row["hypotheses"][1:2].astype(np.float32),
        "exchanged": row["exchanged"][None].astype(np.float32),
        "seen": row["seen"][None],
        "missing": row["missing"][None],
        "evidence": np.array([np.nan if nothing else log_evidence], np.float32),
        "effective": np.array([effective], np.float32),
    }


def _whole(places: NDArray[Any]) -> NDArray[np.int16]:
    """Places as whole numbers of parts of a px, 0 where there is none."""
    limits = np.iinfo(np.int16)
    scaled = np.nan_to_num(np.rint(PER_PX * places), nan=0.0)
    return np.asarray(np.clip(scaled, limits.min, limits.max).astype(np.int16))


def body_view(film: Film, arm: float) -> View:
    """The page of a film with what `drawn_of` gives; `arm` is the length of a stretched one, px."""
    columns = film.columns
    seen = columns["seen"] & ~columns["missing"][:, None]
    inks = dict.fromkeys(range(len(JOINTS)), GREY)
    bones = []
    for colour, chain in CHAINS:
        ink = GREY if colour == TRUNK else css_colour(colour)
        bones += [(*bone, ink) for bone in pairwise(chain)]
        if colour != TRUNK:
            inks.update(dict.fromkeys(chain, ink))
    rows = []
    for joint in sorted(inks, key=lambda joint: joint not in PART_JOINTS):
        there = seen[:, PART_JOINTS.index(joint)] if joint in PART_JOINTS else np.zeros(len(seen), np.bool_)
        rows.append(TimelineRow(joint, JOINTS[joint].replace("_", " "), inks[joint], spans_of(there)))
    joints = columns["joints"].reshape(len(seen), len(JOINTS), -1)
    low, high = np.quantile(joints[..., :3], (0.02, 0.98), axis=(0, 1))
    layer = {
        "joints": columns["joints"],
        "samples": columns["samples"],
        "second": columns["second"],
        "secondWeight": columns["secondWeight"],
        "worthSaying": WORTH_SAYING,
        "perPx": PER_PX,
        "bones": bones,
        "colours": [inks[joint] for joint in range(len(JOINTS))],
        "parts": PART_JOINTS,
        "seen": seen,
        "arm": arm,
        "centre": [*((low[:2] + high[:2]) / 2).tolist(), 0.0],
        "reach": 1.2 * float(max(*(high - low)[:2] / 2, *np.abs([low[2], high[2]]))),
    }
    spread = np.sqrt(np.maximum(joints[:, PART_JOINTS, 3] + joints[:, PART_JOINTS, 6], 0))  # of x and y
    plots = [
        Plot(f"{part.replace('_', ' ')} ±", "px", spread[:, place])
        for place, part in enumerate(PARTS)
        if part != "head"
    ]
    plots.append(Plot("second answer", "%", 100 * columns["secondWeight"]))
    plots.append(Plot("hands exchanged", "%", 100 * columns["exchanged"]))
    plots.append(Plot("log evidence", "nats", columns["evidence"]))
    plots.append(Plot("samples, effective", "", columns["effective"]))
    return View({"body": layer}, rows, plots)
