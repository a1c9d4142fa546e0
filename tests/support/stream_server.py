"""A camera behind an address on loopback: it breaks off, falls silent and comes back as a test wants it."""

import http.server
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import av
import cv2
import numpy as np
from numpy.typing import NDArray

RATE = 25  # pictures a second
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Connection:
    """What becomes of one connection: so many pictures, then it is dropped, or silent until somebody ends it.

    Parameters
    ----------
    pictures
        how many are sent; `None`: not even an answer.
    then
        what comes after them.
    """

    pictures: int | None
    then: Literal["drop", "stall"] = "drop"


@dataclass
class StreamServer:
    """Sends what its camera sees: `images[i]` is there `i / RATE` seconds after the first request.

    Parameters
    ----------
    images
        `(height, width, 3)` uint8 BGR; the last one stays.
    connections
        what becomes of each, in order; later ones are refused.
    form
        Motion JPEG, or a video format of FFmpeg.
    """

    images: Sequence[Image]
    connections: list[Connection]
    form: Literal["mjpeg", "mpegts", "matroska"] = "mjpeg"
    sent: list[int] = field(default_factory=list)
    n_requests: int = 0
    started: float | None = None

    def answer(self, request: http.server.BaseHTTPRequestHandler) -> None:
        """Do with a connection what is to become of it."""
        self.started = self.started or time.monotonic()
        self.n_requests += 1
        if self.n_requests > len(self.connections):
            return
        connection = self.connections[self.n_requests - 1]
        if connection.pictures is not None:
            request.send_response(200)
            parts = "multipart/x-mixed-replace; boundary=frame"
            request.send_header("Content-Type", parts if self.form == "mjpeg" else f"video/{self.form}")
            request.end_headers()
            self._send(request, connection.pictures)
        if connection.then == "stall":
            request.connection.recv(1)  # returns when the other side hangs up

    def _send(self, request: http.server.BaseHTTPRequestHandler, n_pictures: int) -> None:
        with self._writer(request.wfile) as write:
            for index in self._due(n_pictures):
                write(self.images[min(index, len(self.images) - 1)])
                self.sent.append(index)

    def _due(self, n_pictures: int) -> Iterator[int]:
        """Indices of the next pictures, each at its time."""
        assert self.started is not None
        next_index = int((time.monotonic() - self.started) * RATE) + 1
        for index in range(next_index, next_index + n_pictures):
            time.sleep(max(0.0, self.started + index / RATE - time.monotonic()))
            yield index

    @contextmanager
    def _writer(self, file: Any) -> Iterator[Callable[[Image], None]]:
        if self.form == "mjpeg":
            yield lambda image: _write_jpeg(file, image)
            return
        at_once = {"flush_packets": "1"}
        if self.form == "matroska":
            at_once["cluster_time_limit"] = "40"  # ms: otherwise seconds of pictures come together
        with av.open(_Pipe(file), "w", format=self.form, options=at_once) as container:
            stream = container.add_stream("libx264", rate=RATE, options={"tune": "zerolatency", "g": "5"})
            assert isinstance(stream, av.VideoStream)
            stream.height, stream.width = self.images[0].shape[:2]
            stream.pix_fmt = "yuv420p"
            yield lambda image: container.mux(
                stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24"))
            )


class _Pipe:
    """Only what a muxer may do with a connection."""

    def __init__(self, file: Any) -> None:
        self.write = file.write
        self.flush = file.flush


def _write_jpeg(file: Any, image: Image) -> None:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
    file.write(head.encode() + data + b"\r\n")


@contextmanager
def serving(answer: Callable[[http.server.BaseHTTPRequestHandler], None]) -> Iterator[str]:
    """An http server on loopback, by its address."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            with suppress(OSError, av.FFmpegError):  # the other side has hung up
                answer(self)

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        server.block_on_close = False
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
