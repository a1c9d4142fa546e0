"""A film that is read again for every pass: the same frames in any order, however it ends."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.io.film import Film, SeenFrames, is_blank
from rsmcm.apps.io.sources.open_source import open_source
from rsmcm.models import Frame

N_FRAMES = 7


@pytest.fixture
def images(tmp_path: Path) -> Path:
    for number in range(1, N_FRAMES + 1):
        cv2.imwrite(str(tmp_path / f"in{number}.png"), np.full((8, 8, 3), 20 * number, np.uint8))
    return tmp_path


def test_frames_come_in_any_order(images: Path) -> None:
    passes = []

    def passing(frames: Iterator[Frame]) -> Iterator[Frame]:
        passes.append(0)
        for frame in frames:
            passes[-1] += 1
            yield frame

    with (
        open_source(str(images), start=2, step=2) as source,
        Film(lambda: open_source(str(images), start=2, step=2), passing) as film,
    ):
        expected = list(source)
        assert len(film) == len(expected) == 3
        for index in (0, 1, 2, 2, 1, 0, 2, -1):
            frame, other = film[index], expected[index]
            assert (frame.number, frame.time) == (other.number, other.time)
            assert film.time(index) == other.time
            np.testing.assert_array_equal(frame.image, other.image)
        assert [frame.number for frame in film[1:]] == [4, 6]
        with pytest.raises(IndexError):
            film[3]
    assert passes[0] == 3  # to know the times
    assert passes[1] == 3  # one pass forwards, however often a frame is asked for


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
