"""Tracker of moving objects, given one image after the other."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...chains.pixels.camera_motion import CameraMotion, CameraState
from ...inference import RecursiveBP
from ...models.camera.moving_camera import View
from ...models.core.checks import Positive, checked
from ...models.core.frame import GivenBoxes
from ...models.core.short_repr import html_table
from ..background.application import build_model, read_frame_result
from ..background.parameters import with_defaults
from ..exports.coco import object_masks
from ..exports.for_supervision import to_supervision
from ..io.tracks import TrackedObject
from .tracker import Floats, Image, Picture, Tracker

if TYPE_CHECKING:
    import supervision


@dataclass(frozen=True, eq=False)
class Objects:
    """Objects in an image, by increasing identity.

    Parameters
    ----------
    tracks
        one per object, as in `belief["blobs"].tracks()`.
    foreground
        `(height, width)` uint8, 255 for foreground, 0 for background.
    view
        map from the first image to this one, with its covariance (`view.map.inverse` maps back to the first
        image); `None` for a fixed camera.
    """

    tracks: Sequence[TrackedObject]
    foreground: Image
    view: View | None = None

    def __len__(self) -> int:
        return len(self.tracks)

    def _repr_html_(self) -> str:
        """The objects, for notebooks: px, px/s."""
        header = ("identity", "x, y, width, height", "velocity", "existence", "seen")
        rows = ((t.identity, *_rounded(t.box, t.velocity), t.confidence, t.seen) for t in self.tracks)
        return html_table(f"{len(self)} objects", header, rows)

    @cached_property
    def boxes(self) -> Floats:
        """`(n, 4)` px: left, top, right, bottom; 0 is the left or top edge of the image."""
        boxes = self._sizes
        return np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])

    @property
    def identities(self) -> NDArray[np.int64]:
        """`(n,)`: numbers from 1 that stay with the objects, and are never used twice."""
        return np.array([track.identity for track in self.tracks], np.int64)

    @property
    def velocities(self) -> Floats:
        """`(n, 2)` px/s, to the right and down."""
        return np.array([track.velocity for track in self.tracks], np.float64).reshape(-1, 2)

    @property
    def existence(self) -> Floats:
        """`(n,)`, 0 to 1.

        Of an object that a detector has found, the probability that it exists; of others, the share of their
        visible part that the last image showed.
        """
        return np.array([track.confidence for track in self.tracks], np.float64)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """`(n,)`: whether the image or a detector shows the object; otherwise it is only predicted."""
        return np.array([track.seen for track in self.tracks], np.bool_)

    @cached_property
    def masks(self) -> NDArray[np.bool_]:
        """`(n, height, width)`: the foreground inside each box; where boxes overlap, it belongs to both."""
        return object_masks(self.foreground, self._sizes)

    def to_supervision(self) -> "supervision.Detections":
        """Return the objects as `supervision.Detections`, with `tracker_id`, masks and velocities."""
        return to_supervision(self.tracks, self.foreground)

    @property
    def _sizes(self) -> Floats:
        """`(n, 4)` px: x, y, width, height."""
        return np.array([track.box for track in self.tracks], np.float64).reshape(-1, 4)


def _rounded(*values: tuple[float, ...]) -> Iterator[str]:
    return (", ".join(f"{number:.1f}" for number in each) for each in values)


class ObjectTracker(Tracker[None, Objects]):
    """Tracker of moving objects from pixels, and optionally from the boxes of a detector.

    The model is that of `rsmcm background`: an adaptive background, blobs, a ground plane and the detector's
    rates correct each other. Without a detector, everything that moves is an object.

    Parameters
    ----------
    camera
        `"fixed"`, or `"moving"` for one that shakes, turns, zooms or walks.
    parameters
        of the chains, by section and name, as in the file of `--config`.
    frame_rate
        images per second, if `update` gets no time.
    """

    @checked
    def __init__(
        self,
        camera: Literal["fixed", "moving"] = "fixed",
        parameters: Mapping[str, Mapping[str, Any]] | None = None,
        frame_rate: Positive = 25.0,
    ) -> None:
        self._objects = RecursiveBP(build_model(parameters=parameters, camera=camera))
        super().__init__(frame_rate, camera=camera, parameters=with_defaults(parameters or {}))

    @checked
    def update(
        self,
        image: Picture | None,
        boxes: Any = None,
        time: float | None = None,
    ) -> Objects:
        """Return the objects in the next image.

        Parameters
        ----------
        image
            uint8, BGR or grey; `None` if it is missing.
        boxes
            boxes of a detector: `(n, 4)` px, left, top, right, bottom, or `(n, 5)` with a score on any scale;
            or `supervision.Detections`, or the boxes of Ultralytics. `None` if the detector did not run on
            this image; n = 0 if it ran and found nothing, which is evidence against objects.
        time
            s, later than that of the last image.

        Raises
        ------
        TypeError, ValueError
            if an argument has a wrong type, shape or range.
        """
        found = None if boxes is None else GivenBoxes.of(boxes)
        belief = self._step(self._frame(image, time, boxes=found))
        height, width = (belief.state.shape or (0, 0))[:2]
        objects = read_frame_result(belief, (width, height))
        camera: CameraState | None = belief.states.get(CameraMotion.name)
        return Objects(objects.tracks, objects.foreground, None if camera is None else camera.view_of_first)

    def _build(self, start: None) -> RecursiveBP:
        return self._objects

    def _chains(self) -> Mapping[str, Any]:
        return self._objects.model.chains
