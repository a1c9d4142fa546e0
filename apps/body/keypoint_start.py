"""Who is to be tracked, by the points that a detector has found: place, size and lengths of a person."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...models.body.keypoints import head_places, joints_of, largest
from ...models.body.upper_body import PROPORTIONS, UpperBody
from ...models.core.frame import Frame
from ...models.core.keypoints import GivenKeypoints
from ..io.keypoints import Keypoints
from .joint_files import ClickedJoints
from .start import BodyStart, start_from_head

Array = NDArray[np.float64]

MOST_FRAMES = 200
"""From which lengths are taken, evenly spread over all."""


def shows_whom(frame: Frame) -> bool:
    """Whether head, neck or both shoulders of the largest person in a frame were found."""
    given = frame.keypoints
    return (
        given is not None
        and len(given) > 0
        and bool(np.isfinite(head_places(given, 0.0)[largest(given)]).all())
    )


def start_from_keypoints(
    first: Frame, keypoints: Keypoints, images: Sequence[NDArray[np.uint8]], clicked: ClickedJoints | None
) -> BodyStart:
    """Learn size, lengths and colour from the points of the largest person in a frame.

    Parameters
    ----------
    first
        the frame, which has an image, and of which `shows_whom` holds.
    keypoints
        of the whole film.
    images
        of the same size, from all over the film.
    clicked
        joints from which the lengths are taken, if there are any.

    Raises
    ------
    ValueError
        if the points do not tell how large the person is, or the head is not in the picture.
    """
    given = first.keypoints
    assert given is not None
    joints = followed(keypoints, first.number)
    try:
        height = UpperBody.fit(joints).head_height
    except ValueError as error:
        raise ValueError(f"{keypoints.path}: {error}: mark the head in the first frame with --head") from None
    (x, y), width = head_places(given, height)[largest(given)].tolist(), PROPORTIONS["head_width"] * height
    try:
        start = start_from_head(first, (x - width / 2, y - height / 2, width, height), images, clicked)
    except ValueError as error:
        raise ValueError(f"{keypoints.path}, frame {first.number}: {error}") from None
    return start if clicked else with_lengths(start, joints)


def with_lengths(start: BodyStart, joints: Array) -> BodyStart:
    """The same person with lengths from joints `(n, 8, 2)` px, if these tell lengths that a person has."""
    try:
        body = UpperBody.fit(joints, np.full(len(joints), start.parts.head_height))
    except ValueError:
        return start
    n_frames = len(joints)
    origin = f"Fitted to keypoints in {n_frames} frames; what they leave open is as usual."
    return replace(start, body=body, origin=origin)


def followed(keypoints: Keypoints, first: int, head: Array | None = None) -> Array:
    """Joints of one person in some frames, from a frame on: of who is nearest to where the head was before.

    Parameters
    ----------
    keypoints
        of the film.
    first
        number of the first frame.
    head
        `(2,)` px: where the person's head is there; the largest person, if it is not known.

    Returns
    -------
    NDArray
        `(n, 8, 2)` px, NaN where a joint was not found.
    """
    found = []
    for number, given in keypoints.frames():
        if number < first:
            continue
        places = head_places(given, 0.0)
        apart = np.full(len(given), np.inf) if head is None else np.linalg.norm(places - head, axis=1)
        apart = np.where(np.isnan(apart), np.inf, apart)
        person = largest(given) if head is None else int(apart.argmin())
        if head is None or np.isfinite(apart[person]):
            found.append(GivenKeypoints(given.positions[person, None], given.scores[person, None]))
            head = places[person] if np.isfinite(places[person]).all() else head
    chosen = np.unique(np.linspace(0, len(found) - 1, min(len(found), MOST_FRAMES)).round().astype(int))
    return np.concatenate([np.zeros((0, 8, 2)), *(joints_of(found[number]) for number in chosen)])
