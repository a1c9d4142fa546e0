"""`view.html` from a film and what is drawn over it."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...models.files import write_text
from ..reports.links import links_beside
from ..reports.page import templates_in
from .film import Film

VIEW = "view.html"

SEEN, PREDICTED = 0, 1
"""Kinds of spans."""

_TEMPLATES = Path(__file__).parent / "templates"
_environment = templates_in(_TEMPLATES)
_environment.globals["source"] = lambda name: Markup((_TEMPLATES / name).read_text(encoding="utf-8"))


@dataclass(frozen=True, eq=False)
class TimelineRow:
    """A thing that is followed over time.

    Parameters
    ----------
    identity
        by which it is selected.
    label
        what it is called.
    colour
        as CSS has it.
    spans
        `(n, 3)`: first and last index of frames in the film, and `SEEN` or `PREDICTED`.
    """

    identity: int
    label: str
    colour: str
    spans: NDArray[np.int64]


def spans_of(seen: NDArray[np.bool_], frames: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    """The spans of a thing that is there in `frames` `(n,)`, ascending, or in all, and `seen` in some."""
    if frames is None:
        frames = np.arange(len(seen))
    ends = np.flatnonzero((np.diff(frames) > 1) | np.diff(seen))
    first, last = np.append(0, ends + 1), np.append(ends, len(seen) - 1)
    return np.stack([frames[first], frames[last], np.where(seen[first], SEEN, PREDICTED)], axis=1)


@dataclass(frozen=True, eq=False)
class Plot:
    """A curve over the frames of the film; NaN where nothing is known."""

    name: str
    unit: str
    values: NDArray[Any]


@dataclass(frozen=True, eq=False)
class View:
    """What is on the page.

    Parameters
    ----------
    layers
        by the names of their scripts in `templates/layers`, in the order of drawing, the data of each.
    rows, plots
        over time.
    """

    layers: Mapping[str, Any] = field(default_factory=dict)
    rows: Sequence[TimelineRow] = ()
    plots: Sequence[Plot] = ()


def write_view(path: Path, title: str, film: Film, n_frames: int, view: View) -> None:
    """Write the page.

    Parameters
    ----------
    path
        of the file.
    title
        heading.
    film
        its frames; with no path there is a slider over time only.
    n_frames
        of the whole run, which the page says if the film shows fewer.
    view
        what is drawn, and shown beside it.

    Raises
    ------
    OSError
        if the film cannot be read or the page cannot be written; nothing half-written stays behind.
    """
    data = {
        "size": film.size,
        "numbers": film.numbers.astype(np.int32),
        "times": film.times,
        "moments": film.moments,
        "frames": n_frames,
        "rows": [
            {
                "id": row.identity,
                "label": row.label,
                "colour": row.colour,
                "spans": row.spans.astype(np.int32),
            }
            for row in view.rows
        ],
        "plots": [
            {"name": plot.name, "unit": plot.unit, "values": np.asarray(plot.values, np.float32)}
            for plot in view.plots
        ],
        "layers": view.layers,
    }
    inlined = "" if film.path is None else base64.b64encode(film.path.read_bytes()).decode("ascii")
    files = links_beside(path, coming=["report.html"])
    template = _environment.get_template("view.html")
    write_text(
        path,
        template.render(
            title=title, files=files, layers=list(view.layers), data=_json(data), film=Markup(inlined)
        ),
    )


def _json(data: Any) -> Markup:
    """JSON in which an array is its type, shape and bytes in base 64, and nothing ends a script."""
    text = json.dumps(data, default=_packed, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def _packed(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, np.ndarray):
        raise TypeError(f"got {type(value).__name__}, expected what JSON takes, or an array")
    array = np.ascontiguousarray(value)
    array = array.astype(array.dtype.newbyteorder("<"), copy=False)
    name = f"{array.dtype.kind}{array.dtype.itemsize}"
    return {"array": name, "shape": array.shape, "bytes": base64.b64encode(array.tobytes()).decode("ascii")}
