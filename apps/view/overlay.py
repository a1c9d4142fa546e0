"""What was found, drawn on pictures of a film: zones, tracks, points, faces, bodies; and the video of them.

Everything is drawn from the rows of `view.npz`, as the page draws it.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..io.files import PLAYABLE, SegmentedVideo, Worker
from ..io.zones import Zones

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Canvas = NDArray[Any]
"""`(height, width, 3)` uint8, BGR, drawn into (`Any`: OpenCV's stubs give nothing else)."""
Colour = tuple[int, int, int]
"""BGR."""
Row = Mapping[str, NDArray[Any]]

AHEAD = 8  # frames that wait to be drawn while a run saves its state
LONGEST_SIDE = 4096  # px: H.264 takes four times as many
FRACTION_BITS = 4  # of coordinates in OpenCV's drawing
MAX_COORDINATE = 20_000.0  # px; coordinates beyond would overflow there

EDGE: Colour = (20, 20, 20)


# --- colours, sizes, letters ---


def identity_colour(identity: int) -> Colour:
    """Return a BGR colour that is always the same for an identity and far from those of its neighbours."""
    # The golden angle never repeats, and spreads any run of numbers evenly over the hues.
    hue = (identity * 0.6180339887498949) % 1.0
    saturation = (0.9, 0.6, 0.75)[identity % 3]
    red, green, blue = (
        1 - saturation * min(1.0, max(0.0, 2 - abs((hue * 6 + shift) % 6 - 3))) for shift in (0, 4, 2)
    )
    return round(255 * blue), round(255 * green), round(255 * red)


def css_colour(colour: Sequence[int]) -> str:
    """A BGR colour as pages take it, `#rrggbb`."""
    blue, green, red = colour
    return f"#{red:02x}{green:02x}{blue:02x}"


def canvas_of(image: Image) -> Canvas:
    """A copy of a picture `(height, width[, 3])` in colour."""
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()


def enlargement(image: Image, least: int) -> int:
    """By which whole number a picture is enlarged to `least` lines; no side goes beyond `LONGEST_SIDE`."""
    height, width = (int(side) for side in image.shape[:2])
    return max(1, min(-(-least // height), LONGEST_SIDE // max(height, width)))


def caption(number: int, *, missing: bool) -> str:
    """What is written above a frame."""
    return f"frame {number}" + (" (missing)" if missing else "")


def draw_label(
    canvas: Canvas, text: str, corner: tuple[int, int] = (0, 0), colour: Colour = (32, 32, 32)
) -> None:
    """Write text on a filled box that sits on `corner`, or below it at the upper edge."""
    scale = 0.42 * _unit(canvas)
    thickness = max(1, round(2 * scale))
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
    margin = 2 + thickness
    left = min(max(corner[0], 0), max(0, canvas.shape[1] - width - 2 * margin))
    top = max(corner[1] - height - below - margin, 0)
    cv2.rectangle(
        canvas, (left, top), (left + width + 2 * margin, top + height + below + margin), colour, cv2.FILLED
    )
    blue, green, red = colour
    ink = (0, 0, 0) if 0.114 * blue + 0.587 * green + 0.299 * red > 110 else (255, 255, 255)
    origin = (left + margin, top + height + margin - 1)
    cv2.putText(canvas, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, thickness, cv2.LINE_AA)


def _unit(canvas: Canvas) -> float:
    """Lines and letters grow with the picture."""
    return max(1.0, float(canvas.shape[0]) / 480)


def _fixed(points: Array) -> NDArray[np.int32]:
    """Coordinates as OpenCV takes them below whole pixels."""
    near = np.clip(np.nan_to_num(points), -MAX_COORDINATE, MAX_COORDINATE)
    return np.rint(near * (1 << FRACTION_BITS)).astype(np.int32)


# --- zones and lines ---

ZONES: Colour = (0, 200, 255)  # amber: no identity is that bright


def draw_zones(canvas: Canvas, zones: Zones, scale: float = 1.0) -> None:
    """Draw borders, lines with an arrow from left to right, and all names.

    Zones are in px of the film; `scale` is px of the canvas per px of the film.
    """
    thick = max(1, round(1.5 * canvas.shape[0] / 480))
    for zone in zones.zones:
        points = _pixels(zone.polygon, scale)
        for ink, width in ((EDGE, 2 * thick + 1), (ZONES, thick)):
            cv2.polylines(canvas, [points], True, ink, width, cv2.LINE_AA)
    for line in zones.lines:
        ends = np.array([line.start, line.end])
        way = ends[1] - ends[0]
        to_right = 12 * thick / scale * np.array([-way[1], way[0]]) / np.hypot(*way)
        middle = ends.mean(axis=0)
        tail, tip = _pixels(np.array([middle, middle + to_right]), scale).tolist()
        for ink, width in ((EDGE, 2 * thick + 1), (ZONES, thick)):
            cv2.polylines(canvas, [_pixels(ends, scale)], False, ink, width, cv2.LINE_AA)
            cv2.arrowedLine(canvas, tail, tip, ink, width, cv2.LINE_AA, tipLength=0.5)
    for zone in zones.zones:
        _draw_name(canvas, zone.name, _pixels(zone.polygon, scale).mean(axis=0), thick)
    for line in zones.lines:
        _draw_name(canvas, line.name, _pixels(np.array([line.start]), scale)[0], thick)


def _pixels(places: Array, scale: float) -> NDArray[np.int32]:
    """Pixels, whose centres are at whole numbers, of places counted from their edges."""
    return np.rint(scale * places - 0.5).astype(np.int32)


def _draw_name(canvas: Canvas, text: str, middle: Any, thick: int) -> None:
    """Write a name about a place, within the picture."""
    size = 0.42 * _unit(canvas)
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, thick)
    x = min(max(round(middle[0] - width / 2), 2), max(2, canvas.shape[1] - width - 2))
    y = min(max(round(middle[1] + height / 2), height + 2), canvas.shape[0] - below)
    for ink, wide in ((EDGE, thick + 3), (ZONES, thick)):
        cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, ink, wide, cv2.LINE_AA)


# --- tracks in front of a background ---

TRAIL_SECONDS = 2.0
GIVEN: Colour = (200, 200, 200)
# BGR, added to the picture (`Any`: OpenCV's stubs know no scalars)
MASK_TINT: Any = (-40.0, -40.0, 60.0, 0.0)
MASK_OUTLINE: Any = (-255.0, -255.0, 255.0, 0.0)


class TracksOverlay:
    """Draws the foreground, boxes with identities, their trails, a detector's boxes, and zones.

    Frames are drawn in their order: trails are those of the two seconds before.
    """

    def __init__(self, zones: Zones | None = None) -> None:
        self._zones = zones
        self._trails: dict[int, deque[tuple[float, float, float]]] = {}

    def __call__(self, image: Image, row: Row, number: int, time: float, *, missing: bool) -> Image:
        """Draw a frame, seconds after the first; see `Draw`."""
        canvas = canvas_of(image)
        thick = max(1, round(1.6 * _unit(canvas)))
        _tint(canvas, row["outline"], row["corners"])
        if self._zones is not None:
            draw_zones(canvas, self._zones)
        boxes = list(zip(row["id"].tolist(), row["box"].tolist(), strict=True))
        for identity, trail in self._moved(boxes, time).items():
            if len(trail) > 1:
                points = np.rint(np.array(trail)[:, 1:]).astype(np.int32)
                cv2.polylines(canvas, [points], False, identity_colour(identity), thick, cv2.LINE_AA)
        for x, y, w, h in np.rint(row["given"]).astype(int).tolist():
            cv2.rectangle(canvas, (x, y), (x + w - 1, y + h - 1), GIVEN, max(1, thick // 2), cv2.LINE_AA)
        for identity, (x, y, w, h) in boxes:
            colour, corner = identity_colour(identity), (round(x), round(y))
            cv2.rectangle(canvas, corner, (round(x + w) - 1, round(y + h) - 1), colour, thick)
            draw_label(canvas, str(identity), corner, colour)
        draw_label(canvas, caption(number, missing=missing))
        return np.asarray(canvas, np.uint8)

    def _moved(self, boxes: Sequence[tuple[int, Sequence[float]]], time: float) -> dict[int, Any]:
        """Trails of feet until this frame: s and px."""
        for identity, (x, y, w, h) in boxes:
            self._trails.setdefault(identity, deque()).append((time, x + w / 2, y + h))
        for identity in list(self._trails):
            trail = self._trails[identity]
            while trail and trail[0][0] < time - TRAIL_SECONDS:
                trail.popleft()
            if not trail:
                del self._trails[identity]
        return self._trails


def _tint(canvas: Canvas, outline: NDArray[Any], corners: NDArray[Any]) -> None:
    """Tint what polygons, of so many corners each, enclose an odd number of times."""
    if not len(outline):
        return
    polygons = np.split(outline.astype(np.int32), np.cumsum(corners)[:-1])
    mask = np.zeros(canvas.shape[:2], np.uint8)
    cv2.fillPoly(mask, polygons, 255)
    cv2.add(canvas, MASK_TINT, dst=canvas, mask=mask)
    edge = np.zeros_like(mask)
    cv2.polylines(edge, polygons, True, 255, max(1, round(_unit(canvas))))
    cv2.add(canvas, MASK_OUTLINE, dst=canvas, mask=edge)


# --- points ---


TRAIL_FRAMES = 12


class PointsOverlay:
    """Draws points: seen ones as dots with the way that they came, predicted ones as rings.

    Frames are drawn in their order: trails are those of the twelve frames before. A row has `id (n,)`,
    `points (n, 2)` px, and `seen (n,)`, of the points that there are in that frame.
    """

    def __init__(self) -> None:
        self._trail: deque[dict[int, Array]] = deque(maxlen=TRAIL_FRAMES + 1)

    def __call__(self, image: Image, row: Row, number: int, time: float, *, missing: bool) -> Image:
        """Draw a frame; see `Draw`."""
        canvas = canvas_of(image)
        height, width = canvas.shape[:2]
        unit, margin = _unit(canvas), np.array([width, height])
        places, seen = row["points"].astype(np.float64), row["seen"]
        near = np.all((places > -margin) & (places < 2 * margin), axis=1)  # NaN is not near
        names = row["id"].tolist()
        self._trail.append({names[k]: places[k] for k in np.flatnonzero(near & seen).tolist()})
        radius = round(2.2 * unit * (1 << FRACTION_BITS))
        for k in np.flatnonzero(near).tolist():
            colour, centre = identity_colour(names[k]), _fixed(places[k]).tolist()
            if seen[k]:
                trail = _fixed(np.array([then[names[k]] for then in self._trail if names[k] in then]))
                cv2.polylines(canvas, [trail], False, colour, max(1, round(unit)), cv2.LINE_AA, FRACTION_BITS)
                cv2.circle(canvas, centre, radius, colour, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)
            else:
                cv2.circle(canvas, centre, radius, colour, 1, cv2.LINE_AA, FRACTION_BITS)
        draw_label(canvas, caption(number, missing=missing))
        return np.asarray(canvas, np.uint8)


# --- a face ---

LEAST_FACE_HEIGHT = 480  # px; smaller frames are enlarged
DOT, LANDMARK, LOST = (40, 240, 255), (255, 200, 0), (40, 40, 255)
FACES_OF_DOTS = 110.0
"""Radii of a dot that the height of the face has, so that dots of neighbours stay apart."""


def draw_face(image: Image, row: Row, number: int, time: float, *, missing: bool) -> Image:
    """Draw points of a face (yellow), landmarks that are carried on it (light blue), and whether it is lost.

    The row is as of `apps.face.page.FaceDrawing`, the rest as of `Draw`.
    """
    scale = enlargement(image, LEAST_FACE_HEIGHT)
    canvas = cv2.resize(canvas_of(image), None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    unit = canvas.shape[0] / LEAST_FACE_HEIGHT
    points = row["points"][:, :2].astype(np.float64)
    radius = float(np.clip(scale * np.ptp(points[:, 1]) / FACES_OF_DOTS, 0.6 * unit, 2 * unit))
    # the larger dots below the smaller ones: landmarks may be points of the model
    for places, colour, size in ((row["landmarks"], LANDMARK, 1.7 * radius), (points, DOT, radius)):
        known = places[np.isfinite(places).all(axis=1)]
        for ink, reach in ((EDGE, size + unit), (colour, size)):  # no rim covers another dot
            for centre in _fixed((known + 0.5) * scale - 0.5).tolist():
                cv2.circle(
                    canvas,
                    centre,
                    round(reach * (1 << FRACTION_BITS)),
                    ink,
                    cv2.FILLED,
                    cv2.LINE_AA,
                    FRACTION_BITS,
                )
    draw_label(canvas, caption(number, missing=missing))
    if row["states"][0, 0]:
        size, thickness = 1.6 * unit, max(2, round(4 * unit))
        (width, height), _ = cv2.getTextSize("LOST", cv2.FONT_HERSHEY_SIMPLEX, size, thickness)
        corner = ((canvas.shape[1] - width) // 2, 2 * height)
        cv2.putText(canvas, "LOST", corner, cv2.FONT_HERSHEY_SIMPLEX, size, LOST, thickness, cv2.LINE_AA)
    return np.asarray(canvas, np.uint8)


# --- an upper body ---

LEAST_HEIGHT = 360  # px; smaller frames are enlarged, so that skeletons can be told apart
IN_FRONT, BEHIND = 1.1, 0.5  # how far the side view reaches from the root, by the length of a stretched arm
OPACITY = 0.3  # of a sample
REGION_90 = 4.605  # squared Mahalanobis distance that holds 90 % of a Gaussian in the plane
DASH = 6  # px, and as much between two of them

TRUNK: Colour = (235, 235, 235)
LEFT: Colour = (255, 170, 40)
RIGHT: Colour = (40, 120, 255)
PANEL: Colour = (45, 45, 45)
AXIS: Colour = (110, 110, 110)
INK: Colour = (0, 0, 0)

Skeleton = tuple[tuple[Colour, tuple[int, ...]], ...]


@cache
def skeleton() -> Skeleton:
    """Colour and joints of every line of a skeleton."""
    from ...models.body.upper_body import JOINTS  # brings scipy, which other applications do not begin with

    lines = (
        (TRUNK, ("head", "neck")),
        (TRUNK, ("left_shoulder", "neck", "right_shoulder")),
        (LEFT, ("left_shoulder", "left_elbow", "left_hand")),
        (RIGHT, ("right_shoulder", "right_elbow", "right_hand")),
    )
    return tuple((colour, tuple(JOINTS.index(name) for name in names)) for colour, names in lines)


def ends() -> tuple[tuple[Colour, int], ...]:
    """Colour and joint of head and hands, whose uncertainty is drawn."""
    (colour, (head, *_)), _, (left, (*_, left_hand)), (right, (*_, right_hand)) = skeleton()
    return (colour, head), (left, left_hand), (right, right_hand)


@dataclass(frozen=True, eq=False)
class TrackedBody:
    """What is shown of a body in a frame.

    Parameters
    ----------
    samples
        `(n, 8, 3)` px: joints of poses that were drawn from the posterior.
    joints, covariances
        `(8, 3)` px and `(8, 3, 3)` px^2: their posterior means and covariances.
    state
        text that is written after the frame's number: what was not seen, for instance.
    second
        `(8, 3)` px: another pose that is worth showing.
    """

    samples: Array
    joints: Array
    covariances: Array
    state: str = ""
    second: Array | None = None


class BodyOverlay:
    """Draws tracked bodies.

    On the frame, the samples' skeletons thin and translucent, the mean bold, and ellipses that hold head and
    hands with a probability of 90 %; the arms of a second answer dashed and paler. The person's left arm is
    blue, the right one orange. Right of it the same from the side, at the same height and scale: z to the
    right, so the viewer stands on the left. `reach` is the length of a stretched arm, px, by which the side
    view is as wide as it is.
    """

    def __init__(self, reach: float) -> None:
        self._reach = reach

    def draw(self, image: Image, body: TrackedBody, caption: str) -> Image:
        """Draw a body on a copy of its frame `(height, width[, 3])` BGR, and from the side.

        The caption is written before the body's state. Below 360 lines the picture is enlarged.
        """
        scale = enlargement(image, LEAST_HEIGHT)
        large = cv2.resize(canvas_of(image), None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
        height, width = large.shape[:2]
        # a body that is larger than the picture is still worth a side view that is no wider than it
        room = min(scale * self._reach * (IN_FRONT + BEHIND), float(width))
        panel: Canvas = np.full((height, round(room), 3), PANEL, np.uint8)
        root = panel.shape[1] * IN_FRONT / (IN_FRONT + BEHIND)
        cv2.line(panel, (round(root), 0), (round(root), height), AXIS, 1, cv2.LINE_AA)
        centre = np.array([root / scale + 0.5 / scale - 0.5, 0.0])
        views = ((large, (0, 1), np.zeros(2)), (panel, (2, 1), centre))
        for canvas, axes, shift in views:
            unit = _unit(canvas)
            samples = _on_canvas(body.samples[..., axes] + shift, scale)
            mean = _on_canvas(body.joints[:, axes] + shift, scale)
            for skeleton in samples:
                _draw_translucent(canvas, skeleton, unit)
            _draw_skeleton(canvas, mean, INK, round(4 * unit))
            _draw_skeleton(canvas, mean, None, round(2 * unit))
            if body.second is not None:
                _draw_dashed(canvas, _on_canvas(body.second[:, axes] + shift, scale), unit)
        for colour, joint in ends():
            place = _on_canvas(body.joints[joint, :2], scale)
            _draw_region(large, place, scale**2 * body.covariances[joint, :2, :2], colour)
        draw_label(large, f"{caption}: {body.state}" if body.state else caption)
        draw_label(panel, f"{len(body.samples)} samples from the side, viewer on the left")
        return np.asarray(np.hstack([large, panel]), np.uint8)


def _on_canvas(places: Array, scale: int) -> Array:
    """Places of the frame, px, on its enlarged copy; far ones are brought near enough to be drawn."""
    return np.clip(np.nan_to_num((places + 0.5) * scale - 0.5), -MAX_COORDINATE, MAX_COORDINATE)


def _draw_skeleton(canvas: Canvas, joints: Array, colour: Colour | None, thickness: int) -> None:
    """Draw a skeleton `(8, 2)` px; in the colours of its sides if none is given."""
    for own, chain in skeleton():
        points = [_fixed(joints[list(chain)])]
        ink = own if colour is None else colour
        cv2.polylines(canvas, points, False, ink, thickness, cv2.LINE_AA, FRACTION_BITS)


def _draw_dashed(canvas: Canvas, joints: Array, unit: float) -> None:
    """Draw the arms of a skeleton `(8, 2)` px, so that they are no other's."""
    for colour, chain in skeleton():
        if colour == TRUNK:
            continue
        pale = tuple((each + 255) // 2 for each in colour)
        for start, end in pairwise(joints[list(chain)]):
            length = min(float(np.hypot(*(end - start))), MAX_COORDINATE)
            edges = np.arange(0.0, 1.0, 2 * DASH * unit / max(length, 1.0))
            dashes = np.stack([edges, np.minimum(edges + DASH * unit / max(length, 1.0), 1.0)], axis=1)
            lines = _fixed(start + dashes[..., None] * (end - start))
            for ink, thickness in ((INK, round(3 * unit)), (pale, round(1.5 * unit))):
                cv2.polylines(canvas, list(lines), False, ink, thickness, cv2.LINE_AA, FRACTION_BITS)


def _draw_translucent(canvas: Canvas, joints: Array, unit: float) -> None:
    """Blend a skeleton into the part of the picture that it covers."""
    margin = 3 * unit
    low = np.maximum(np.floor(joints.min(axis=0) - margin).astype(int), 0)
    high = np.minimum(np.ceil(joints.max(axis=0) + margin).astype(int) + 1, canvas.shape[1::-1])
    if (low >= high).any():
        return
    part = canvas[low[1] : high[1], low[0] : high[0]]
    layer = part.copy()
    _draw_skeleton(layer, joints - low, None, max(1, round(unit)))
    cv2.addWeighted(layer, OPACITY, part, 1 - OPACITY, 0, dst=part)


def _draw_region(canvas: Canvas, place: Array, covariance: Array, colour: Colour) -> None:
    """Draw the ellipse that holds 90 % of a Gaussian."""
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance))
    axes = np.minimum(np.sqrt(REGION_90 * np.maximum(values, 0)), MAX_COORDINATE)
    turn = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    (x, y), (minor, major) = (_fixed(each).tolist() for each in (place, axes))
    for ink, thickness in ((INK, 2), (colour, 1)):
        cv2.ellipse(canvas, (x, y), (major, minor), turn, 0, 360, ink, thickness, cv2.LINE_AA, FRACTION_BITS)


# --- the video ---


class Draw(Protocol):
    """Draws what was found on frames, which come in their order."""

    def __call__(self, image: Image, row: Row, number: int, time: float, *, missing: bool) -> Image:
        """Draw on a copy of a frame, perhaps enlarged: `(height, width, 3)` BGR.

        Parameters
        ----------
        image
            `(height, width[, 3])` of the frame, or of the one before where it is `missing`.
        row
            its row of `view.npz`.
        number, time
            from 1, and s.
        """


class OverlayVideo:
    """A video of frames with what was found on them, drawn in their order in a thread.

    Without a path, pictures are shown only: `show` is given each, in that thread. See `SegmentedVideo` for
    `resume_after`.
    """

    def __init__(
        self,
        path: Path | None,
        rate: float,
        draw: Draw,
        resume_after: int | None = None,
        show: Callable[[Image], None] | None = None,
    ) -> None:
        self._video = None if path is None else SegmentedVideo(path, rate, PLAYABLE, resume_after)
        self._worker = Worker("overlay", AHEAD)
        self._draw, self._show = draw, show
        self._image: Image | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._worker.stop()
        finally:
            if self._video is not None:
                self._video.close()

    def checkpoint(self) -> None:
        """Return when everything is on disk and readable."""
        self._worker.wait()
        if self._video is not None:
            self._video.checkpoint()

    def add(self, frame: Frame, row: Callable[[], Row]) -> None:
        """Append a frame and what was found on it, made in a thread by `row`; it must not change any more.

        An OSError, if the video cannot be written, may come with a later frame.
        """
        self._worker.submit(self._add, frame, row)

    def _add(self, frame: Frame, row: Callable[[], Row]) -> None:
        self._image = self._image if frame.image is None else frame.image
        if self._image is None:
            return  # nothing seen yet, not even the size
        with np.errstate(all="ignore"):  # places that are not known, and those beyond all pictures
            picture = self._draw(self._image, row(), frame.number, frame.time, missing=frame.missing)
        if self._video is not None:
            self._video.write(picture, frame.number, frame.time)
        if self._show is not None:
            self._show(picture)
