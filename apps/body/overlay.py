"""A tracked upper body as pictures, as in Fig. 4 of the RSMCM paper: samples from front and side."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.body.upper_body import JOINTS
from ..drawing.boxes import draw_overlay
from ..drawing.overlay_video import enlargement

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

LEAST_HEIGHT = 360  # px; smaller frames are enlarged, so that skeletons can be told apart
IN_FRONT, BEHIND = 1.1, 0.5  # how far the side view reaches from the root, by the length of a stretched arm
OPACITY = 0.3  # of a sample
REGION_90 = 4.605  # squared Mahalanobis distance that holds 90 % of a Gaussian in the plane
DASH = 6  # px, and as much between two of them
FRACTION_BITS = 4  # of coordinates in OpenCV's drawing
FARTHEST = 20_000.0  # px; coordinates beyond would overflow there

TRUNK: Colour = (235, 235, 235)  # BGR
LEFT: Colour = (255, 170, 40)
RIGHT: Colour = (40, 120, 255)
PANEL: Colour = (45, 45, 45)
AXIS: Colour = (110, 110, 110)
INK: Colour = (0, 0, 0)

CHAINS: tuple[tuple[Colour, tuple[int, ...]], ...] = tuple(
    (colour, tuple(JOINTS.index(name) for name in names))
    for colour, names in (
        (TRUNK, ("head", "neck")),
        (TRUNK, ("left_shoulder", "neck", "right_shoulder")),
        (LEFT, ("left_shoulder", "left_elbow", "left_hand")),
        (RIGHT, ("right_shoulder", "right_elbow", "right_hand")),
    )
)
"""Colour and joints of every line of a skeleton."""

REGIONS = tuple(
    (colour, JOINTS.index(name))
    for colour, name in ((TRUNK, "head"), (LEFT, "left_hand"), (RIGHT, "right_hand"))
)


@dataclass(frozen=True, eq=False)
class TrackedBody:
    """What is shown of a body in a frame.

    Parameters
    ----------
    samples
        `(n, 8, 3)` px: joints of poses that were drawn from the posterior.
    joints
        `(8, 3)` px: their posterior means.
    covariances
        `(8, 3, 3)` px^2.
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
    right, so the viewer stands on the left.

    Parameters
    ----------
    reach
        px: length of a stretched arm, by which the side view is as wide as it is.
    """

    def __init__(self, reach: float) -> None:
        self._reach = reach

    def draw(self, image: Image, body: TrackedBody, caption: str) -> Image:
        """Draw a body on a copy of its frame, and from the side.

        Parameters
        ----------
        image
            `(height, width)` or `(height, width, 3)` BGR.
        body
            what is known of it.
        caption
            text in the upper left corner, before the body's state.

        Returns
        -------
        NDArray[np.uint8]
            `(height, wider, 3)` BGR, enlarged by a whole number below 360 lines.
        """
        scale = enlargement(image, LEAST_HEIGHT)
        large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
        if large.ndim == 2:
            large = cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)
        height, width = large.shape[:2]
        # a body that is larger than the picture is still worth a side view that is no wider than it
        room = min(scale * self._reach * (IN_FRONT + BEHIND), float(width))
        panel: NDArray[Any] = np.full((height, round(room), 3), PANEL, np.uint8)
        root = panel.shape[1] * IN_FRONT / (IN_FRONT + BEHIND)
        _draw_axes(panel, root)
        centre = np.array([root / scale + 0.5 / scale - 0.5, 0.0])
        views = ((large, (0, 1), np.zeros(2)), (panel, (2, 1), centre))
        for canvas, axes, shift in views:
            unit = max(1.0, height / 480)
            samples = _on_canvas(body.samples[..., axes] + shift, scale)
            mean = _on_canvas(body.joints[:, axes] + shift, scale)
            for skeleton in samples:
                _draw_translucent(canvas, skeleton, unit)
            _draw_skeleton(canvas, mean, INK, round(4 * unit))
            _draw_skeleton(canvas, mean, None, round(2 * unit))
            if body.second is not None:
                _draw_dashed(canvas, _on_canvas(body.second[:, axes] + shift, scale), unit)
        for colour, joint in REGIONS:
            place = _on_canvas(body.joints[joint, :2], scale)
            _draw_region(large, place, scale**2 * body.covariances[joint, :2, :2], colour)
        text = f"{caption}: {body.state}" if body.state else caption
        note = f"side view of {len(body.samples)} samples"
        return np.hstack([_labelled(large, text), _labelled(panel, note)])


def _on_canvas(places: Array, scale: int) -> Array:
    """Places of the frame, px, on its enlarged copy; far ones are brought near enough to be drawn."""
    return np.clip(np.nan_to_num((places + 0.5) * scale - 0.5), -FARTHEST, FARTHEST)


def _fixed(points: Array) -> NDArray[np.int32]:
    """Coordinates as OpenCV takes them below whole pixels."""
    return np.rint(points * (1 << FRACTION_BITS)).astype(np.int32)


def _draw_skeleton(canvas: NDArray[Any], joints: Array, colour: Colour | None, thickness: int) -> None:
    """Draw a skeleton `(8, 2)` px; in the colours of its sides if none is given."""
    for own, chain in CHAINS:
        points = [_fixed(joints[list(chain)])]
        ink = own if colour is None else colour
        cv2.polylines(canvas, points, False, ink, thickness, cv2.LINE_AA, FRACTION_BITS)


def _draw_dashed(canvas: NDArray[Any], joints: Array, unit: float) -> None:
    """Draw the arms of a skeleton `(8, 2)` px, so that they are no other's."""
    for colour, chain in CHAINS:
        if colour == TRUNK:
            continue
        pale = tuple((each + 255) // 2 for each in colour)
        for start, end in pairwise(joints[list(chain)]):
            length = min(float(np.hypot(*(end - start))), FARTHEST)
            edges = np.arange(0.0, 1.0, 2 * DASH * unit / max(length, 1.0))
            dashes = np.stack([edges, np.minimum(edges + DASH * unit / max(length, 1.0), 1.0)], axis=1)
            lines = _fixed(start + dashes[..., None] * (end - start))
            for ink, thickness in ((INK, round(3 * unit)), (pale, round(1.5 * unit))):
                cv2.polylines(canvas, list(lines), False, ink, thickness, cv2.LINE_AA, FRACTION_BITS)


def _draw_translucent(canvas: NDArray[Any], joints: Array, unit: float) -> None:
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


def _draw_region(canvas: NDArray[Any], place: Array, covariance: Array, colour: Colour) -> None:
    """Draw the ellipse that holds 90 % of a Gaussian."""
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance))
    axes = np.minimum(np.sqrt(REGION_90 * np.maximum(values, 0)), FARTHEST)
    turn = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    (x, y), (minor, major) = (_fixed(each).tolist() for each in (place, axes))
    for ink, thickness in ((INK, 2), (colour, 1)):
        cv2.ellipse(canvas, (x, y), (major, minor), turn, 0, 360, ink, thickness, cv2.LINE_AA, FRACTION_BITS)


def _draw_axes(panel: NDArray[Any], root: float) -> None:
    """Say what the side view's directions are, about the root's depth."""
    height, width = panel.shape[:2]
    middle, bottom = round(root), height - 10
    cv2.line(panel, (middle, 0), (middle, height), AXIS, 1, cv2.LINE_AA)
    for end, text in ((6, "towards the viewer"), (width - 7, "away, z")):
        cv2.arrowedLine(panel, (middle, bottom), (end, bottom), AXIS, 1, cv2.LINE_AA, tipLength=0.06)
        _write(panel, text, ((middle + end) / 2, bottom - 5))
    cv2.arrowedLine(panel, (width - 12, 60), (width - 12, 110), AXIS, 1, cv2.LINE_AA, tipLength=0.15)
    _write(panel, "y", (width - 22, 110))


def _write(panel: NDArray[Any], text: str, middle: Sequence[float]) -> None:
    """Write text above a place."""
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)
    corner = (max(round(middle[0] - width / 2), 0), round(middle[1]))
    cv2.putText(panel, text, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (190, 190, 190), 1, cv2.LINE_AA)


def _labelled(picture: NDArray[Any], text: str) -> Image:
    return draw_overlay(np.asarray(picture, np.uint8), None, (), {}, text)
