"""Frames in which nothing is seen."""

from collections.abc import Iterator

import numpy as np
from rsmcm.apps.io.sources.blank_frames import SeenFrames, is_blank
from rsmcm.models import Frame


def test_frames_without_contrast_are_blank() -> None:
    random = np.random.default_rng(0)
    noise = random.integers(0, 4, (120, 160, 3)).astype(np.uint8)
    assert is_blank(noise)
    assert is_blank(255 - noise)
    assert is_blank(np.full((5, 5), 77, np.uint8))
    assert not is_blank(random.integers(0, 30, (120, 160)).astype(np.uint8))


def test_a_source_that_breaks() -> None:
    """Blank frames come as missing ones; the error is kept until somebody asks."""
    picture = np.random.default_rng(0).integers(0, 255, (48, 64)).astype(np.uint8)

    def source() -> Iterator[Frame]:
        for number, image in enumerate((picture, np.zeros_like(picture), None, picture), start=1):
            yield Frame(image, number / 25, number)
        raise OSError("unplugged")

    frames = SeenFrames(source())
    seen = list(frames)
    assert [frame.number for frame in seen] == [1, 2, 3, 4]
    assert [frame.missing for frame in seen] == [False, True, True, False]
    assert frames.blank == [2]
    assert str(frames.error) == "unplugged"
