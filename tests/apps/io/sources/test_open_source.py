"""Sources give every frame once, in order, with its number and time, and say what is damaged."""

import math
import struct
import threading
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.io.sources import images
from rsmcm.apps.io.sources.open_source import Source, open_source
from rsmcm.models.core.frame import Frame

HEIGHT, WIDTH = 48, 64


def picture(number: int, height: int = HEIGHT, width: int = WIDTH) -> NDArray[np.uint8]:
    """A smooth texture, and the number as a gray level in the upper left block."""
    texture = np.random.default_rng(7).integers(60, 200, (height, width, 3), dtype=np.uint8)
    image = np.roll(cv2.GaussianBlur(texture, (9, 9), 0), number, axis=1)
    image[:16, :16] = level(number)
    return np.asarray(image, dtype=np.uint8)


def level(number: int) -> int:
    return 20 + 5 * number


def number_of(frame: Frame) -> int:
    assert frame.image is not None
    return round((float(frame.image[4:12, 4:12].mean()) - 20) / 5)


def write_video(
    path: Path,
    n_frames: int = 40,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    title: str = "",
    **options: str,
) -> Path:
    with av.open(str(path), "w", options={"movflags": "+faststart"} if path.suffix == ".mp4" else {}) as file:
        stream = file.add_stream(codec, rate=Fraction(25), options=options)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixels
        file.metadata["title"] = title
        stream.bit_rate = 4_000_000  # so that the gray levels survive
        for number in range(1, n_frames + 1):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture(number), format="bgr24")))
        file.mux(stream.encode(None))
    return path


def packet_positions(path: Path) -> list[tuple[int, int]]:
    with av.open(str(path)) as file:
        return [(packet.pos or 0, packet.size) for packet in file.demux(video=0) if packet.size]


def write_images(folder: Path, n_images: int = 12, pattern: str = "frame{}.png") -> Path:
    folder.mkdir()
    for number in range(1, n_images + 1):
        cv2.imwrite(str(folder / pattern.format(number)), picture(number))
    return folder


def read(source: Path | str, **selection: int) -> tuple[Source, list[Frame]]:
    with open_source(str(source), **selection) as opened:
        return opened, list(opened)


@pytest.fixture(autouse=True)
def _quiet(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Nothing is ever written to standard error, not by the libraries either."""
    yield
    assert capfd.readouterr().err == ""


# --- video --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [
        ("a.mp4", "libx264", "yuv420p"),
        ("a.mkv", "libx264", "yuv420p"),
        ("a.avi", "mpeg4", "yuv420p"),
        ("a.avi", "mjpeg", "yuvj420p"),
        ("a.webm", "libvpx", "yuv420p"),
        ("a.ts", "libx264", "yuv420p"),
        ("a.mkv", "ffv1", "gray"),
    ],
)
def test_every_frame_once_in_order(tmp_path: Path, name: str, codec: str, pixels: str) -> None:
    source, frames = read(write_video(tmp_path / name, codec=codec, pixels=pixels))
    assert [number_of(frame) for frame in frames] == list(range(1, 41))
    assert [frame.number for frame in frames] == list(range(1, 41))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(40) / 25, atol=1e-9)
    assert (source.kind, source.n_frames, source.rate, source.size) == ("video", 40, 25.0, (WIDTH, HEIGHT))
    assert not source.truncated
    assert not source.skipped
    assert {frame.image.shape for frame in frames if frame.image is not None} == {
        (HEIGHT, WIDTH) if pixels == "gray" else (HEIGHT, WIDTH, 3)
    }


@pytest.mark.skipif(not hasattr(av.VideoStream, "set_display_rotation"), reason="av below 17.1 writes none")
@pytest.mark.parametrize("turn", [90, -90, 180])
def test_video_of_a_turned_phone_stands_upright(tmp_path: Path, turn: int) -> None:
    path = write_video(tmp_path / "turned.mp4", 3)
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 44  # a, b, u, c, d, v, x, y, w of the track's header
    cosine, sine = (
        round(value) << 16 for value in (math.cos(math.radians(turn)), math.sin(math.radians(turn)))
    )
    struct.pack_into(">9i", data, matrix, cosine, sine, 0, -sine, cosine, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    source, frames = read(path)
    _, expected = cv2.VideoCapture(str(path)).read()
    assert frames[0].image is not None
    assert frames[0].image.shape == expected.shape
    assert np.abs(frames[0].image.astype(int) - expected).mean() < 2
    assert source.size == (expected.shape[1], expected.shape[0])


@pytest.mark.parametrize(
    ("start", "stop", "step"), [(1, 40, 1), (17, None, 1), (5, 33, 7), (40, 99, 3), (8, 8, 2)]
)
def test_selection_equals_slice_of_everything(
    tmp_path: Path, start: int, stop: int | None, step: int
) -> None:
    path = write_video(tmp_path / "a.mp4", g="12", bf="2")
    _, everything = read(path)
    with open_source(str(path), start, stop, step) as source:
        frames = list(source)
    expected = everything[start - 1 : stop : step]
    assert [frame.number for frame in frames] == [frame.number for frame in expected]
    assert [frame.time for frame in frames] == [frame.time for frame in expected]
    for frame, other in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(frame.image, other.image)
    assert source.n_frames == len(expected)


def test_after_leaves_out_what_an_earlier_run_processed(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4")
    _, frames = read(path, start=3, step=4, after=15)
    assert [frame.number for frame in frames] == list(range(19, 41, 4))
    source, frames = read(path, after=40)
    assert frames == []
    assert source.n_frames == 40
    assert source.size == (WIDTH, HEIGHT)


def test_truncated_video_gives_frames_until_the_damage(tmp_path: Path) -> None:
    for name, codec in [("a.mp4", "libx264"), ("a.mkv", "libx264"), ("a.avi", "mjpeg"), ("a.webm", "libvpx")]:
        in_order = {"bf": "0"} if codec == "libx264" else {}  # packets in the order of frames
        pixels = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        path = write_video(tmp_path / name, codec=codec, pixels=pixels, **in_order)
        position, size = packet_positions(path)[25]
        path.write_bytes(path.read_bytes()[: position + size // 2])
        source, frames = read(path)
        assert source.truncated, name
        assert 20 <= len(frames) <= 26, name
        assert [number_of(frame) for frame in frames] == list(range(1, len(frames) + 1)), name
        assert not source.skipped, name


def test_damaged_packet_is_a_missing_frame_in_its_place(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", codec="mjpeg", pixels="yuvj420p")
    data = bytearray(path.read_bytes())
    position, size = packet_positions(path)[9]
    data[position + 12 : position + size - 12] = bytes(size - 24)  # leaves the chunks' own headers alone
    path.write_bytes(data)
    source, frames = read(path)
    assert source.skipped == [10]
    assert frames[9].image is None
    assert [number_of(frame) for frame in frames if frame.image is not None] == [
        number for number in range(1, 41) if number != 10
    ]
    assert [frame.number for frame in frames] == list(range(1, 41))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(40) / 25, atol=1e-9)
    assert not source.truncated


def test_variable_frame_rate_keeps_its_time_stamps(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    times = [0.0, 0.04, 0.08, 0.5, 0.54, 2.0]
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, moment in enumerate(times, start=1):
            frame = av.VideoFrame.from_ndarray(picture(number), format="bgr24")
            frame.pts, frame.time_base = round(moment * 1000), Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    _, frames = read(path)
    np.testing.assert_allclose([frame.time for frame in frames], times, atol=1e-9)


@pytest.mark.parametrize("content", [b"", b"hello world " * 50, bytes(range(256)) * 20])
@pytest.mark.parametrize("name", ["a.mp4", "a.txt", "a"])
def test_no_video(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"{name}: not a video that can be read") as caught:
        open_source(str(path))
    assert "\n" not in str(caught.value)


def large_avi(path: Path, width: int, height: int, *, in_header: bool) -> Path:
    """A film of which the header, or all pictures but the first, claim that they are large."""
    write_video(path, 3, "mjpeg", "yuvj420p")
    data = bytearray(path.read_bytes())
    if in_header:
        struct.pack_into("<ii", data, data.index(b"strf") + 12, width, height)
    for position, _ in packet_positions(path)[0 if in_header else 1 :]:
        struct.pack_into(">HH", data, data.index(b"\xff\xc0", position) + 5, height, width)
    path.write_bytes(data)
    return path


def test_large_video_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    path = large_avi(tmp_path / "a.avi", 16_000, 16_000, in_header=True)
    with pytest.raises(
        ValueError, match=r"a\.avi: got pictures of 16000x16000 px, expected 134217728 pixels"
    ):
        open_source(str(path))


@pytest.mark.parametrize(
    ("selection", "message"),
    [
        ({"start": 0}, "start: got 0"),
        ({"step": 0}, "step: got 0"),
        ({"start": 5, "stop": 4}, "stop: got 4, expected 5"),
        ({"start": 13}, "start: got 13, but .* has only 12 frames"),
    ],
)
def test_bad_selection(tmp_path: Path, selection: dict[str, int], message: str) -> None:
    for path in (write_video(tmp_path / "a.mp4", 12), write_images(tmp_path / "images", 12)):
        with pytest.raises(ValueError, match=message):
            open_source(str(path), **selection)


# --- images -------------------------------------------------------------------------------------------------


def test_images_sort_naturally_and_other_files_are_ignored(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "images", 12)
    (folder / "notes.txt").write_text("no image")
    (folder / ".hidden.png").write_bytes(b"no image")
    for name in (folder, folder / "frame*.png"):
        source, frames = read(name)
        assert [number_of(frame) for frame in frames] == list(range(1, 13))
        assert [frame.time for frame in frames] == [index / 25 for index in range(12)]
        assert (source.kind, source.n_frames, source.size) == ("images", 12, (WIDTH, HEIGHT))


@pytest.mark.parametrize("place", ["images", "."])
def test_frame_rate_of_a_mot_sequence(tmp_path: Path, place: str) -> None:
    folder = write_images(tmp_path / "images", 2)
    (tmp_path / place / "seqinfo.ini").write_text("[Sequence]\nname=a\nframeRate=10\n")
    assert open_source(str(folder)).rate == 10


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp"])
@pytest.mark.parametrize("damage", ["truncated", "garbage", "empty"])
def test_damaged_image_is_a_missing_frame(tmp_path: Path, suffix: str, damage: str) -> None:
    folder = write_images(tmp_path / "images", 7, "frame{}." + suffix)
    for number in (1, 4):
        path = folder / f"frame{number}.{suffix}"
        data = path.read_bytes()
        path.write_bytes(
            {"truncated": data[: len(data) * 2 // 3], "garbage": b"no image" * 20, "empty": b""}[damage]
        )
    source, frames = read(folder)
    assert source.skipped == [1, 4]
    assert [frame.number for frame in frames] == list(range(1, 8))
    assert [number_of(frame) for frame in frames if frame.image is not None] == [2, 3, 5, 6, 7]
    assert source.size == (WIDTH, HEIGHT)


def test_images_of_another_size_or_type_are_named(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "images", 4)
    cv2.imwrite(str(folder / "frame3.png"), picture(3)[:40])
    with pytest.raises(ValueError, match="frame 3 is 64x40 colour, expected 64x48 colour"):
        read(folder)
    cv2.imwrite(str(folder / "frame3.png"), picture(3)[:, :, 0])
    with pytest.raises(ValueError, match="frame 3 is 64x48 gray, expected 64x48 colour"):
        read(folder)


def test_nothing_there(tmp_path: Path) -> None:
    for name in ("no-such-file.mp4", "*.png", "."):
        with pytest.raises(FileNotFoundError):
            open_source(str(tmp_path / name))
    folder = write_images(tmp_path / "images", 1)
    (folder / "frame1.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match="holds no readable frame"):
        open_source(str(folder))


# --- identity, addresses, cameras ---------------------------------------------------------------------------


def test_fingerprint_tells_sources_apart(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", 5)
    same = open_source(str(path), start=3).fingerprint()
    assert same == open_source(str(path)).fingerprint()
    write_video(path, 6)
    assert same != open_source(str(path)).fingerprint()
    folder = write_images(tmp_path / "images", 3)
    before = open_source(str(folder)).fingerprint()
    (folder / "frame2.png").rename(folder / "frame4.png")
    assert before != open_source(str(folder)).fingerprint()


def test_address_or_camera_that_is_not_there() -> None:
    with pytest.raises(OSError, match=r"^rtsp://127\.0\.0\.1:9/x: cannot be opened") as caught:
        open_source("rtsp://user:secret@127.0.0.1:9/x")
    assert "secret" not in str(caught.value)
    with pytest.raises(OSError, match="camera 97: cannot be opened"):
        open_source("97")
    with pytest.raises(ValueError, match="ftp://a/b: expected an address of one of"):
        open_source("ftp://a/b")


def test_no_thread_that_decodes_a_picture_outlives_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture(number))
    begun = threading.Event()

    def slow(path: Path) -> NDArray[np.uint8]:
        if path.stem == "1":
            begun.set()
            time.sleep(0.3)
        return picture(int(path.stem))

    monkeypatch.setattr(images, "read_image", slow)
    monkeypatch.setattr("rsmcm.apps.io.sources.open_source.CLOSING_SECONDS", 0.0)
    with open_source(str(tmp_path)) as source:
        assert begun.wait(10)
    assert not source._thread.is_alive()
