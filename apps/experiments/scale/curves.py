"""All curves, what is wanted of them, and what they are drawn as."""

from collections.abc import Mapping, Sequence

from ....models.numerics.threads import set_threads
from ..expectations import Expectation
from ..experiment import Experiment, Plot
from ..measuring.machine import bandwidth, drawing, operations
from ..record import Table
from .curve import tables
from .of_pictures import over_frames_of_a_film, over_objects, over_pixels
from .of_points import over_observations, over_points, over_tracks
from .of_poses import over_experts, over_samples, over_texels
from .picture import draw, size

WANTED: Mapping[str, float] = {"frames so far": 0.05, "tracks": 1.2}
"""Powers by unit; of all others `LINEAR`."""

LINEAR = 1.1
PEER = "MOG2"
GROWN = 32.0
"""MB."""


def curves(n_frames: int) -> Experiment:
    """Measure all of them.

    Parameters
    ----------
    n_frames
        of the film over which time and memory are watched.
    """
    set_threads(1)
    over_time, grown = over_frames_of_a_film(n_frames)
    found = [
        *over_pixels(),
        *over_objects(),
        *over_time,
        *over_points(),
        *over_observations(),
        *over_tracks(),
        *over_samples(),
        *over_experts(),
        *over_texels(),
    ]
    expectations = [
        each.expectation(None if each.name == PEER else WANTED.get(each.unit, LINEAR)) for each in found
    ]
    what = f"memory grown over the last four fifths of {n_frames} frames, MB"
    expectations.append(Expectation(what, grown, "<=", GROWN))
    everything = [*tables(found), machine_table()]
    plot = Plot("curves.png", lambda canvas: draw(canvas, found), size(found), "Time; dashed: its limit.")
    return Experiment("Cost as curves", everything, expectations, [plot])


def machine_table() -> Table:
    """What the limits are worked out with."""
    rows: list[Sequence[object]] = [
        (f"{n_bytes >> 10} kB moved, GB/s", bandwidth(n_bytes) / 1e9, bandwidth(n_bytes, 2) / 1e9)
        for n_bytes in (1 << 18, 1 << 22, 1 << 26, 1 << 28)
    ]
    rows.append(("operations of single precision, 1e9/s", operations() / 1e9, None))
    rows.append(("normal numbers drawn, 1e9/s", 1e-9 / drawing(1.0), None))
    return Table(
        ("what", "one thread", "two"),
        rows,
        "What the limits are worked out with: copies, products of matrices, random numbers.",
    )
