"""The small picture of a film."""

import base64
from itertools import chain
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from rsmcm.apps.batch.application import thumbnail


@pytest.mark.parametrize(
    ("size", "small"), [((64, 48), (64, 48)), ((640, 240), (160, 60)), ((2, 1000), (1, 120))]
)
def test_a_thumbnail_has_the_shape_of_the_film(
    tmp_path: Path, size: tuple[int, int], small: tuple[int, int]
) -> None:
    width, height = size
    assert thumbnail(tmp_path / "none.mp4") == ""
    with av.open(str(tmp_path / "film.mp4"), "w") as film:
        stream = film.add_stream("mpeg4", rate=5)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        picture = av.VideoFrame.from_ndarray(np.full((height, width, 3), 90, np.uint8))
        film.mux(chain(stream.encode(picture), stream.encode()))
    data = np.frombuffer(base64.b64decode(thumbnail(tmp_path / "film.mp4")), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (small[1], small[0], 3)
    (tmp_path / "broken.mp4").write_bytes(b"x" * 99)
    assert thumbnail(tmp_path / "broken.mp4") == ""
