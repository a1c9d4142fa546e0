"""A plan on paper: what a thousand cameras and a billion observations need, worked out from records."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...evaluation.text_tables import rounded
from ..record import Record, Table
from ..scale.capacity import HEADER, RATE
from ..scale.curve import Curve, of_record
from ..scale.of_points import LENGTH

CAMERAS = 1000
BUSY = 0.7
"""Share of a core that may be planned with: films are not all alike."""

EVERY = 500
"""Frames between two saved states, if not given."""

MACHINE = (32, 128)
"""Cores and GB of one machine."""

OBSERVATIONS = 10**9
WORKERS = 100
NETWORK = 10e9
"""Bits a second into one machine."""

NUMBER = 8
"""Bytes of one of double precision."""

OF_CAMERA = 18
"""Numbers that are summed over points, and sent, of a camera: a symmetric 4x4 matrix, and two vectors of 4.
As many come back: two rows of 4, and the second moments."""

OF_POINT = 35
"""Numbers that are held of a point: place, covariance, information, vector, error, second moments."""

OF_TABLE = 3
"""Numbers of each frame and point in a table of positions and weights."""

ENGINE = ("all chains", "pixels")
ITERATION = ("an iteration of EM", "observations")


@dataclass(frozen=True)
class Carried:
    """What one core of a busy machine carries of a film, from a line of the table of capacity."""

    size: tuple[int, int]
    seconds: float
    memory: float
    read: float
    written: float
    state: float


def carried(record: Record) -> list[Carried]:
    """Per size of film, with one process on every core: the slowest film of each.

    Raises
    ------
    ValueError
        if it is no record of capacity.
    """
    found: dict[tuple[int, int], Carried] = {}
    for row in _rows(record):
        processes, threads = (int(word) for word in row["processes x threads"].split(" x "))
        if processes != record.made.cores or threads != 1:
            continue
        width, height = (int(word) for word in row["size"].split("x"))
        one = Carried(
            (width, height),
            processes / row["frames/s"],
            1e6 * row["memory a process, MB"],
            1e3 * row["kB a frame read"],
            1e3 * row["kB a frame written"],
            1e6 * row["saved state, MB"],
        )
        if one.size not in found or found[one.size].seconds < one.seconds:
            found[one.size] = one
    return [found[size] for size in sorted(found)]


def _rows(record: Record) -> list[Mapping[str, Any]]:
    for table in record.tables:
        if tuple(table.header) == HEADER:
            return [dict(zip(HEADER, row, strict=True)) for row in table.rows]
    raise ValueError(f"{record.name}: got a record without a table of capacity")


def of_cameras(capacity: Record, curves: Record) -> Table:
    """What a thousand cameras need, by the size of their pictures."""
    engine, columns = of_record(curves)[ENGINE], carried(capacity)
    rows = {
        "a frame of a whole run on one core, ms": [1e3 * each.seconds for each in columns],
        "of which the engine by its curve, ms": [1e3 * engine.at(math.prod(each.size)) for each in columns],
        f"cores, {100 * BUSY:.0f} % busy": [_cores(each) for each in columns],
        "memory with a process a camera, GB": [_memory(each) for each in columns],
        f"machines of {MACHINE[0]} cores, for the cores": [_cores(each) / MACHINE[0] for each in columns],
        f"machines of {MACHINE[1]} GB, for the memory": [_memory(each) / MACHINE[1] for each in columns],
        "films that come in, Gbit/s": [CAMERAS * RATE * each.read * 8 / 1e9 for each in columns],
        "results that are written, MB/s": [CAMERAS * RATE * each.written / 1e6 for each in columns],
        "the same, TB a day": [CAMERAS * RATE * each.written * 86_400 / 1e12 for each in columns],
        f"states saved every {EVERY} frames, MB/s": [
            CAMERAS * each.state * RATE / EVERY / 1e6 for each in columns
        ],
        "states that are read after all machines were off, GB": [
            CAMERAS * each.state / 1e9 for each in columns
        ],
    }
    header = ("", *(f"{each.size[0]}x{each.size[1]}" for each in columns))
    return Table(header, [(name, *map(rounded, values)) for name, values in rows.items()])


def _cores(each: Carried) -> float:
    return CAMERAS * RATE * each.seconds / BUSY


def _memory(each: Carried) -> float:
    """GB."""
    return CAMERAS * each.memory / 1e9


def of_observations(curves: Record) -> Table:
    """What an iteration needs as far as it was measured, and at a billion observations."""
    iteration = of_record(curves)[ITERATION]
    largest = iteration.points[-1].size
    sizes = (largest, float(OBSERVATIONS))
    columns = [_iteration(iteration, size) for size in sizes]
    header = ("", *(f"{size:.2g}" for size in sizes))
    return Table(header, [(name, *(rounded(each[name]) for each in columns)) for name in columns[0]])


def _iteration(curve: Curve, count: float) -> dict[str, float]:
    """Of so many observations, of tracks as they are in the curve."""
    points, frames = count / LENGTH, max(40.0, math.sqrt(count) / 2)
    seconds, sent = curve.at(count), NUMBER * OF_CAMERA * frames
    lists = count * curve.bytes_each
    return {
        "points": points,
        "frames": frames,
        "lists of observations, GB": lists / 1e9,
        "a table of all frames and points instead, GB": NUMBER * OF_TABLE * frames * points / 1e9,
        "what is held of the points, GB": NUMBER * OF_POINT * points / 1e9,
        "an iteration on one core, s": seconds,
        f"the same by blocks of points on {WORKERS} cores, s": seconds / WORKERS,
        "sums of the cameras that a block sends, MB": sent / 1e6,
        f"to one machine and back from {WORKERS} blocks, s": 2 * WORKERS * sent * 8 / NETWORK,
        "the same where blocks of a machine are summed first, s": (
            2 * math.ceil(WORKERS / MACHINE[0]) * sent * 8 / NETWORK
        ),
    }


def room(curves: Record) -> str:
    """Observations at which the memory of a machine is full, in words."""
    each, memory = of_record(curves)[ITERATION].bytes_each, 1e9 * MACHINE[1]
    # a table of sqrt(n) / 2 frames and n / LENGTH points
    table = (memory * 2 * LENGTH / (NUMBER * OF_TABLE)) ** (2 / 3)
    return (
        f"{MACHINE[1]} GB hold lists of {memory / each:.1e} observations, or a table of frames and points of "
        f"{table:.1e}."
    )
