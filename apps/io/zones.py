"""Zones and lines in the picture: how far a foot is from their borders, and the files that hold them."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...models.core.checks import Bound, Count, NotNegative, Shape, checked
from ...models.core.short_repr import short_repr
from ...models.files import MOST_SETTINGS, read_text
from ..options.complaints import meant
from ..options.settings import read_settings

Corners = NDArray[np.float64]

ON_EDGE = 0.01
"""Share of the picture's side, up to which a corner beside the picture's edge is taken to lie on it."""

WITHIN = 1e-9
"""Share of the picture's side by which a foot at its edge is inside of it."""


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class Zone:
    """Polygon of the image.

    It has no border at the edge of the image, where no crossing is visible.

    Parameters
    ----------
    name
        of the zone.
    polygon
        `(n, 2)` px, corners in either order; integer coordinates are pixel edges, as for boxes.
    size
        `(width, height)` px of the picture.
    """

    name: str
    polygon: Annotated[Corners, Shape(None, 2), Bound(lambda corners: len(corners) > 2, "3 corners or more")]
    size: tuple[Count, Count]
    _starts: Corners = field(init=False, repr=False)
    _ways: Corners = field(init=False, repr=False)
    _inner: NDArray[np.bool_] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        size = np.array(self.size, np.float64)
        starts = np.where(self.polygon <= ON_EDGE * size, 0.0, self.polygon)
        starts = np.where(starts >= (1 - ON_EDGE) * size, size, starts)
        ends = np.roll(starts, -1, axis=0)
        on_edge = (starts == ends) & ((starts == 0) | (starts == size))
        object.__setattr__(self, "_starts", starts)
        object.__setattr__(self, "_ways", ends - starts)
        object.__setattr__(self, "_inner", ~on_edge.any(axis=1))

    def distance(self, places: ArrayLike) -> NDArray[np.float64]:
        """Distance of positions `(..., 2)` px from the border, px; negative outside.

        It is infinite without a border. Positions outside the image are moved to its edge.
        """
        size = np.array(self.size, np.float64)
        within = np.minimum(np.maximum(places, WITHIN * size), (1 - WITHIN) * size)
        offsets, ways = within[..., None, :] - self._starts, self._ways
        # a ray to the right crosses the border an odd number of times
        above = offsets[..., 1] < 0
        below = np.roll(above, -1, axis=-1)
        side = ways[:, 0] * offsets[..., 1] - ways[:, 1] * offsets[..., 0]
        crosses = (above != below) & ((side < 0) == (ways[:, 1] < 0))
        inside = crosses.sum(axis=-1) % 2 > 0
        offsets, ways = offsets[..., self._inner, :], ways[self._inner]
        along = np.minimum(np.maximum((offsets * ways).sum(axis=-1) / (ways * ways).sum(axis=1), 0), 1)
        off = offsets - along[..., None] * ways
        nearest = np.sqrt((off * off).sum(axis=-1)).min(axis=-1, initial=np.inf)
        distances: NDArray[np.float64] = np.where(inside, nearest, -nearest)
        return distances


@checked
@short_repr
@dataclass(frozen=True)
class Line:
    """Line of the image that is crossed from left to right, or from right to left.

    Left and right are seen in the direction of the line: of a line that points to the right, above is left.

    Parameters
    ----------
    name
        of the line.
    start, end
        px, as of `Zone`.
    left_to_right, right_to_left
        names of the two directions.
    size
        `(width, height)` px of the image: a line that reaches its edge continues beyond, for feet below the
        edge. `None`: it does not.
    """

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    left_to_right: str = "left to right"
    right_to_left: str = "right to left"
    size: tuple[Count, Count] | None = None

    def __post_init__(self) -> None:
        if self.start == self.end:
            raise ValueError(f"end: got {self.end}, which is the start, expected another place")

    def distance(self, place: tuple[float, float]) -> float:
        """Distance of a position to the right of the infinite line, px; negative to its left."""
        (x, y), (to_x, to_y) = self.start, self.end
        dx, dy = to_x - x, to_y - y
        return (dx * (place[1] - y) - dy * (place[0] - x)) / float(np.hypot(dx, dy))

    def is_beside(self, place: tuple[float, float]) -> bool:
        """Whether a position on the infinite line is between its ends, or beyond one at the image edge."""
        (x, y), (to_x, to_y) = self.start, self.end
        dx, dy = to_x - x, to_y - y
        share = (dx * (place[0] - x) + dy * (place[1] - y)) / (dx * dx + dy * dy)
        return (share >= 0 or self._leaves(self.start, (-dx, -dy))) and (
            share <= 1 or self._leaves(self.end, (dx, dy))
        )

    def _leaves(self, end: tuple[float, float], way: tuple[float, float]) -> bool:
        """Whether who goes on from an end of the line is out of the picture."""
        return self.size is not None and any(
            (place <= ON_EDGE * side and step < 0) or (place >= (1 - ON_EDGE) * side and step > 0)
            for place, step, side in zip(end, way, self.size, strict=True)
        )


@checked
@short_repr
@dataclass(frozen=True, eq=False)
class Zones:
    """All zones and lines of an image, and the time limits of standing and leaving.

    Parameters
    ----------
    zones, lines
        with unique names.
    still_after
        s without motion after which a person stands still.
    max_coast_time
        s for which a person may be hidden without leaving.
    """

    zones: tuple[Zone, ...] = ()
    lines: tuple[Line, ...] = ()
    still_after: NotNegative = 2.0
    max_coast_time: NotNegative = 3.0

    def plain(self) -> dict[str, Any]:
        """Return names and corners (px) for a page, with the keys of a file of zones."""
        return {
            "zones": [{"name": zone.name, "polygon": zone.polygon.tolist()} for zone in self.zones],
            "lines": [{"name": line.name, "from": line.start, "to": line.end} for line in self.lines],
        }


MOST_CORNERS = 1000
"""Of one polygon: whether it crosses itself is asked of every pair of its edges."""

MOST_LETTERS = 200
"""Of a name."""

LARGEST = 1e9
"""Of numbers, whether px or s."""

NEAREST = 1e-3
"""px, between places that differ."""

KEYS = {"zone": ("name", "polygon"), "line": ("name", "from", "to", "left_to_right", "right_to_left")}
OPTIONS = ("units", "still_after", "max_coast_time")
RENAMED = {"patience": "max_coast_time"}
"""Old names of options."""
UNITS = ("px", "relative")


@checked
def read_zones(path: str | Path, size: tuple[int, int]) -> Zones:
    """Read zones and lines.

    Parameters
    ----------
    path
        `.toml` with `[[zone]]` (`name`, `polygon`) and `[[line]]` (`name`, `from`, `to`, and perhaps names
        for its directions, `left_to_right` and `right_to_left`), and perhaps `units` ("px" of the picture, or
        "relative", from 0 to 1), `still_after` and `max_coast_time` (s). Or `.json` as LabelMe writes it, of
        which polygons and lines are taken.
    size
        `(width, height)` px of the image.

    Raises
    ------
    ValueError
        in one line with file and entry, if it is not such a file, or a zone or line does not fit this image.
    OSError
        if the file cannot be read.
    """
    path, where = Path(path), f"--zones: {path}"
    try:
        entries = _read_labelme(path) if path.suffix.lower() == ".json" else read_settings(path)
    except ValueError as error:
        raise ValueError(f"--zones: {error}") from None
    unknown = next((key for key in entries if key not in (*KEYS, *OPTIONS)), None)
    if unknown in RENAMED:
        raise ValueError(f"{where}: unknown key {unknown!r}, it is {RENAMED[unknown]} now")
    if unknown is not None:
        raise _unknown(where, unknown, (*KEYS, *OPTIONS))
    units = entries.get("units", UNITS[0])
    if units not in UNITS:
        raise ValueError(f"{where}: units: got {units!r}, expected {' or '.join(UNITS)}")
    reader = _Reader(size, relative=units == "relative")
    zones = [reader.zone(*each) for each in _entries(entries, "zone", where)]
    lines = [reader.line(*each) for each in _entries(entries, "line", where)]
    if not zones and not lines:
        raise ValueError(f"{where}: got neither [[zone]] nor [[line]], expected one at least")
    seconds = {
        key: _seconds(entries[key], f"{where}: {key}")
        for key in ("still_after", "max_coast_time")
        if key in entries
    }
    return Zones(tuple(zones), tuple(lines), **seconds)


def _entries(entries: Mapping[str, Any], kind: str, where: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Where each one is, and its values."""
    tables = entries.get(kind, [])
    if not isinstance(tables, list):
        raise ValueError(f"{where}: {kind}: got {_short(tables)}, expected [[{kind}]]")
    for number, table in enumerate(tables, start=1):
        place = f"{where}: {kind} {number}"
        if not isinstance(table, Mapping):
            raise ValueError(f"{place}: got {_short(table)}, expected [[{kind}]]")
        unknown = next((key for key in table if key not in KEYS[kind]), None)
        if unknown is not None:
            raise _unknown(place, unknown, KEYS[kind])
        yield place, table


class _Reader:
    """Makes zones and lines from values; it knows the names that are taken."""

    def __init__(self, size: tuple[int, int], *, relative: bool) -> None:
        self._size = size
        self._scale = np.array(size if relative else (1, 1), np.float64)
        self._limits = (1.0, 1.0) if relative else (float(size[0]), float(size[1]))
        self._names: set[str] = set()

    def zone(self, where: str, values: Mapping[str, Any]) -> Zone:
        name = self._name(values, where)
        where = f"{where} ({name}): polygon"
        given = values.get("polygon", [])
        if not isinstance(given, list):
            raise ValueError(f"{where}: got {_short(given)}, expected a list of corners [x, y]")
        corners = [self._corner(each, f"{where}: corner {k}") for k, each in enumerate(given, start=1)]
        if len(corners) > 1 and corners[0] == corners[-1]:
            corners.pop()  # closed, as some have it
        if not 3 <= len(corners) <= MOST_CORNERS:
            raise ValueError(f"{where}: got {len(corners)} corners, expected 3 to {MOST_CORNERS}")
        polygon = np.array(corners) * self._scale
        _check(polygon, where)
        return Zone(name, polygon, self._size)

    def line(self, where: str, values: Mapping[str, Any]) -> Line:
        name = self._name(values, where)
        where = f"{where} ({name})"
        for key in ("from", "to"):
            if key not in values:
                raise ValueError(f"{where}: got no {key!r}, expected a point [x, y]")
        start, end = (self._corner(values[key], f"{where}: {key}") for key in ("from", "to"))
        if np.hypot(*(self._scale * np.subtract(end, start))) < NEAREST:
            raise ValueError(f"{where}: got one place as both ends, expected a line with a length")
        there, back = (
            _text(values.get(key, usual), f"{where}: {key}")
            for key, usual in (("left_to_right", Line.left_to_right), ("right_to_left", Line.right_to_left))
        )
        if there == back:
            raise ValueError(f"{where}: got {there!r} for both directions, expected two names")
        return Line(name, self._scaled(start), self._scaled(end), there, back, self._size)

    def _name(self, values: Mapping[str, Any], where: str) -> str:
        name = _text(values.get("name", ""), f"{where}: name")
        if name in self._names:
            raise ValueError(f"{where}: name: got {name!r} again, expected one that no other has")
        self._names.add(name)
        return name

    def _scaled(self, point: tuple[float, float]) -> tuple[float, float]:
        return point[0] * float(self._scale[0]), point[1] * float(self._scale[1])

    def _corner(self, given: object, where: str) -> tuple[float, float]:
        if not (isinstance(given, list) and len(given) == 2 and all(map(_is_number, given))):
            raise ValueError(f"{where}: got {_short(given)}, expected two numbers [x, y]")
        x, y = float(given[0]), float(given[1])
        width, height = self._limits
        if not (0 <= x <= width and 0 <= y <= height):
            raise ValueError(
                f"{where}: got {_short(given)}, expected a place in the picture, from 0, 0 to {width:g}, "
                f"{height:g}"
            )
        return x, y


def _check(polygon: Corners, where: str) -> None:
    """Refuse a polygon that crosses or touches itself."""
    count = len(polygon)
    starts, ends = polygon, np.roll(polygon, -1, axis=0)
    for k in range(count):
        if np.hypot(*(ends[k] - starts[k])) < NEAREST:
            raise ValueError(f"{where}: got corner {k + 1} twice, expected corners that differ")
    for k in range(count):
        others = np.arange(k + 2, count if k else count - 1)  # those that share no corner with it
        crossed = others[_meet(starts[k], ends[k], starts[others], ends[others])]
        if len(crossed):
            raise ValueError(
                f"{where}: got edges that cross, {k + 1} and {crossed[0] + 1}, expected a border that "
                "does not cross itself"
            )
    if not abs(_area(polygon)) > 0:
        raise ValueError(f"{where}: got corners on one straight line, expected an area")


def _meet(start: Corners, end: Corners, starts: Corners, ends: Corners) -> Any:
    """Whether a line meets each of others, touching included."""
    one, other = _turn(start, end, starts), _turn(start, end, ends)
    back, forth = _turn(starts, ends, start), _turn(starts, ends, end)
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    near = ((low <= np.maximum(start, end)) & (high >= np.minimum(start, end))).all(axis=-1)
    return near & (one * other <= 0) & (back * forth <= 0)


def _turn(start: Corners, end: Corners, place: Corners) -> Any:
    """On which side of a line a place is: more than 0 to the right, less to the left."""
    way, to = end - start, place - start
    return np.sign(way[..., 0] * to[..., 1] - way[..., 1] * to[..., 0])


def _area(polygon: Corners) -> float:
    x, y = (polygon - polygon[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def _text(given: object, where: str) -> str:
    if not (isinstance(given, str) and 0 < len(given) <= MOST_LETTERS and given.isprintable()):
        raise ValueError(
            f"{where}: got {_short(given)}, expected a text on one line, of {MOST_LETTERS} letters at most"
        )
    if given.lstrip()[:1] in ("=", "+", "-", "@"):  # it stands in cells of events.csv
        raise ValueError(f"{where}: got {_short(given)}, which a spreadsheet takes for a formula")
    return given


def _seconds(given: object, where: str) -> float:
    if not (_is_number(given) and float(given) > 0):  # type: ignore[arg-type]
        raise ValueError(f"{where}: got {_short(given)}, expected seconds, more than 0")
    return float(given)  # type: ignore[arg-type]


def _is_number(given: object) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool) and abs(given) <= LARGEST


def _short(given: object) -> str:
    text = repr(given)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _unknown(where: str, key: str, keys: Sequence[str]) -> ValueError:
    return ValueError(f"{where}: unknown key {_short(key)}, expected {', '.join(keys)}{meant(key, keys)}")


def _read_labelme(path: Path) -> dict[str, Any]:
    """Polygons and lines of a LabelMe file, whose places are px of a picture that may have another size."""
    text = read_text(path, "expected LabelMe's JSON", MOST_SETTINGS)
    try:
        content = json.loads(text)
        size = content["imageWidth"], content["imageHeight"]
        if not all(_is_number(side) and side > 0 for side in size):
            raise TypeError
        found: dict[str, Any] = {"units": "relative", "zone": [], "line": []}
        for shape in content["shapes"]:
            kind, name = shape["shape_type"], shape["label"]
            points = [[x / size[0], y / size[1]] for x, y in shape["points"]]
            if kind == "polygon":
                found["zone"].append({"name": name, "polygon": points})
            elif kind == "line":
                start, end = points
                found["line"].append({"name": name, "from": start, "to": end})
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        raise ValueError(
            f"{path}: got something else, expected LabelMe's JSON (imageWidth, imageHeight, shapes)"
        ) from None
    return found
