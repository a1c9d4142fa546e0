"""A decoded picture of a video as an upright BGR image."""

from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray


def to_bgr(picture: av.VideoFrame) -> NDArray[np.uint8]:
    """Return the picture as BGR (gray stays gray), turned upright.

    OpenCV's conversion takes 0.15-0.3 ms at 768x576, FFmpeg's 0.8 ms (decoding alone: 0.28). So the common
    form of video goes through OpenCV; together that is as quick as `cv2.VideoCapture` (0.56 ms), which has
    neither exact time stamps nor a word about damage. OpenCV knows only the television range of BT.601, so
    full-range, BT.709 and all rarer forms are left to FFmpeg.
    """
    name = picture.format.name
    image: NDArray[Any]
    if name in ("gray", "gray8"):
        image = picture.to_ndarray()
    elif (
        name == "yuv420p"
        and picture.width % 2 == 0
        and picture.height % 2 == 0
        and picture.color_range != 2  # full range
        and picture.colorspace in (2, 5, 6)  # unspecified, BT.601 for 625 and for 525 lines
    ):
        image = cv2.cvtColor(picture.to_ndarray(), cv2.COLOR_YUV2BGR_I420)
    else:
        image = picture.to_ndarray(format="bgr24")
    quarter_turns = round(picture.rotation / 90) % 4  # counter-clockwise, as a phone notes how it was held
    if quarter_turns:
        image = np.ascontiguousarray(np.rot90(image, quarter_turns))
    return np.asarray(image, dtype=np.uint8)
