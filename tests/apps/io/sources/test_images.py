"""Still pictures: as OpenCV and Pillow read them, upright, and none that memory does not hold."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image, ImageOps
from rsmcm.apps.io.sources import video_reader
from rsmcm.apps.io.sources.images import IMAGE_SUFFIXES, SCALED, read_grey, read_image, to_8_bits
from rsmcm.apps.io.sources.open_source import open_source
from rsmcm.apps.runs import memory

from ....conftest import Command

HEIGHT, WIDTH = 64, 80
SUFFIXES = sorted(IMAGE_SUFFIXES - {".pbm"})  # OpenCV writes that with one bit only


def picture(kind: type = np.uint8, channels: int = 3) -> NDArray[Any]:
    """Smooth, so that lossy formats keep it."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    planes = [rows * 4, columns * 3, rows + columns][:channels]
    scale = 257 if kind is np.uint16 else 1
    return np.asarray(np.squeeze(np.dstack(planes)) * scale, kind)


def write(path: Path, image: NDArray[Any]) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("channels", [1, 3])
def test_as_opencv_reads_it(tmp_path: Path, suffix: str, channels: int) -> None:
    if (suffix, channels) in ((".pgm", 3), (".ppm", 1)):
        pytest.skip("no such form")
    path = write(tmp_path / f"a{suffix}", picture(channels=channels))
    image, grey = read_image(path), read_grey(path)
    assert image is not None
    assert grey is not None
    np.testing.assert_array_equal(image, cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(grey, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_turned_as_exif_says(tmp_path: Path, orientation: int) -> None:
    path = tmp_path / "turned.jpg"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(picture()[:, :, ::-1]).save(path, exif=exif, quality=95)
    with Image.open(path) as stored:
        expected = np.asarray(ImageOps.exif_transpose(stored))
    image, grey = read_image(path), read_grey(path)
    assert image is not None
    assert grey is not None
    assert image.shape == expected.shape
    assert grey.shape == expected.shape[:2]
    assert np.abs(image[:, :, ::-1].astype(int) - expected).max() <= 2, "decoders round differently"
    with open_source(str(path)) as source:
        assert source.size == (expected.shape[1], expected.shape[0])


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm", ".jp2"])
def test_16_bits_are_scaled_and_that_is_said_once(tmp_path: Path, suffix: str) -> None:
    for number in (1, 2):
        write(tmp_path / f"deep{number}{suffix}", picture(np.uint16, channels=1))
    with open_source(str(tmp_path)) as source:
        frames = list(source)
        assert source.notes == [SCALED]
    for frame in frames:
        np.testing.assert_array_equal(frame.image, picture(channels=1))
    np.testing.assert_array_equal(read_grey(tmp_path / f"deep1{suffix}"), picture(channels=1))


@given(st.integers(0, 65535))
def test_scaling_is_even_from_black_to_white(value: int) -> None:
    (scaled,) = to_8_bits(np.array([[value]], np.uint16)).ravel()
    assert abs(int(scaled) - value / 257) <= 0.5


def test_float_pictures_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", picture(channels=1).astype(np.float32))
    with pytest.raises(ValueError, match=r"a\.tif: has float32 values, expected 8 or 16 bits a channel$"):
        open_source(str(path))


# --- pictures that are too large ----------------------------------------------------------------------------


def png(width: int, height: int) -> bytes:
    """A whole black picture of one bit a pixel."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    deflate = zlib.compressobj(9)
    row = bytes(1 + -(-width // 8))
    data = b"".join(deflate.compress(row) for _ in range(height)) + deflate.flush()
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def jpeg() -> bytes:
    """A small picture whose header says that it is a large one."""
    data = bytearray(cv2.imencode(".jpg", picture())[1].tobytes())
    struct.pack_into(">HH", data, data.index(b"\xff\xc0") + 5, 25_000, 25_000)
    return bytes(data)


def decoded(*_: object) -> None:
    raise AssertionError("decoded")


LARGE: dict[str, Callable[[], bytes]] = {
    ".png": lambda: png(25_000, 25_000),
    ".jpg": jpeg,
    ".ppm": lambda: b"P6\n25000 25000\n255\n" + bytes(1000),
}


@pytest.mark.parametrize("suffix", LARGE)
def test_large_pictures_are_refused_before_they_are_decoded(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"large{suffix}"
    path.write_bytes(LARGE[suffix]())
    monkeypatch.setattr(cv2, "imdecode", decoded)
    words = Command("background").complaint(capfd, path, "--out", tmp_path / "out")
    assert words.startswith(f"rsmcm: {path}: has more than 134217728 pixels")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["background", "structure", "face", "body"])
@pytest.mark.parametrize("is_film", [False, True])
def test_pictures_that_a_run_has_no_memory_for_are_refused_before_they_are_decoded(
    name: str,
    is_film: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "large"
    if is_film:
        with av.open(str(path), "w", format="avi") as film:
            stream = film.add_stream("mjpeg", rate=25, width=1200, height=900, pix_fmt="yuvj420p")
            film.mux(stream.encode(av.VideoFrame(1200, 900, "yuvj420p")))
            film.mux(stream.encode(None))
    else:
        path.mkdir()
        for number in range(3):
            (path / f"{number}.png").write_bytes(png(1200, 900))
    monkeypatch.setattr(memory.psutil, "virtual_memory", lambda: SimpleNamespace(available=1_000_000))
    monkeypatch.setattr(cv2, "imdecode", decoded)
    monkeypatch.setattr(video_reader, "to_bgr", decoded)
    words = Command(name).complaint(capfd, path, "--out", tmp_path / "out")
    assert words.startswith(f"rsmcm: {path}: a run on 1200x900 px with these settings needs about")
    assert not (tmp_path / "out").exists()
