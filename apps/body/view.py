"""A body's part of `view.html`: skeletons over the film and in space, and how sure each joint is."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from ...models.body.upper_body import JOINTS, PARTS
from ..view.film import Film, Row
from ..view.page import Plot, TimelineRow, View, spans_of
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
    samples = np.rint(PER_PX * row["samples"][::every][:SAMPLES])
    limits = np.iinfo(np.int16)
    nothing = row["missing"] or row["stationary"]
    return {
        "joints": np.concatenate([row["joints_3d"], upper], axis=1).astype(np.float32),
        "samples": np.clip(samples, limits.min, limits.max).astype(np.int16),
        "seen": row["seen"][None],
        "missing": row["missing"][None],
        "evidence": np.array([np.nan if nothing else log_evidence], np.float32),
        "effective": np.array([effective], np.float32),
    }


def body_view(film: Film, reach: float) -> View:
    """The page of a film with what `drawn_of` gives; `reach` is the length of a stretched arm, px."""
    columns = film.columns
    seen = columns["seen"] & ~columns["missing"][:, None]
    inks = dict.fromkeys(range(len(JOINTS)), GREY)
    bones = []
    for colour, chain in CHAINS:
        ink = GREY if colour == TRUNK else _css(colour)
        bones += [(*bone, ink) for bone in pairwise(chain)]
        if colour != TRUNK:
            inks.update(dict.fromkeys(chain, ink))
    rows = []
    for joint in sorted(inks, key=lambda joint: joint not in PART_JOINTS):
        there = seen[:, PART_JOINTS.index(joint)] if joint in PART_JOINTS else np.zeros(len(seen), np.bool_)
        rows.append(TimelineRow(joint, JOINTS[joint].replace("_", " "), inks[joint], spans_of(there)))
    layer = {
        "joints": columns["joints"],
        "samples": columns["samples"],
        "perPx": PER_PX,
        "bones": bones,
        "colours": [inks[joint] for joint in range(len(JOINTS))],
        "parts": PART_JOINTS,
        "seen": seen,
        "reach": reach,
    }
    variances = columns["joints"].reshape(len(seen), len(JOINTS), -1)[:, PART_JOINTS, 3:]
    spread = np.sqrt(np.maximum(variances[..., 0] + variances[..., 3], 0))
    plots = [
        Plot(f"{part.replace('_', ' ')} unsure by", "px", spread[:, place])
        for place, part in enumerate(PARTS)
        if part != "head"
    ]
    plots.append(Plot("log evidence", "nats", columns["evidence"]))
    plots.append(Plot("samples, effective", "", columns["effective"]))
    return View({"body": layer}, rows, plots)


def _css(colour: tuple[int, int, int]) -> str:
    blue, green, red = colour
    return f"#{red:02x}{green:02x}{blue:02x}"
