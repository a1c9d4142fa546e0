"""The page of a run that goes on: what the run tells, and the server of its picture and state by HTTP.

Nothing else is served, and nobody can change anything.
"""

import ipaddress
import json
import logging
import re
import socket
import socketserver
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..options.job import Address

Image = NDArray[np.uint8]
State = Literal["starting", "running", "finishing", "ended", "failed"]
"""Waits for its first frame; takes in frames; writes results; has written them; could not."""

LONGEST_SIDE = 1280  # px
QUALITY = 80  # of JPEG
INTERVAL = 0.04  # s between two pictures: a film may be processed faster than anybody looks
RECENT = 50  # frames over which their rate is taken
SHOWN_EVENTS = 20


class Picture(NamedTuple):
    """A JPEG of a picture, which counts from 1."""

    number: int
    data: bytes


class Running:
    """A run as it is just now, whose results go to the folder `out`.

    The run calls `begin`, `show`, `on_frame`, `finish` and `end`, none of which waits for anybody; other
    threads call the rest.
    """

    def __init__(self, out: Path) -> None:
        self._changed = threading.Condition()
        self._encoding = threading.Lock()
        self._state: State = "starting"
        self._title = ""
        self._out = out
        self._n_frames: int | None = None
        self._stream: Callable[[], Mapping[str, Any] | None] = lambda: None
        self._frame: tuple[int, float, bool] | None = None  # number, time, whether it is missing
        self._facts: Mapping[str, object] = {}
        self._events: deque[str] = deque(maxlen=SHOWN_EVENTS)
        self._moments: deque[float] = deque(maxlen=RECENT)
        self._words: Sequence[str] = ()
        self._picture: Image | None = None
        self._number = 0  # of the picture
        self._encoded = Picture(0, b"")
        self._encoded_at = -INTERVAL

    # --- called by the run ---

    def begin(self, title: str, n_frames: int | None, stream: Callable[[], Mapping[str, Any] | None]) -> None:
        """Say what runs: how many frames are expected, if that is known, and what becomes of the stream."""
        with self._changed:
            self._title, self._n_frames, self._stream = title, n_frames, stream

    def on_frame(self, frame: Frame, facts: Mapping[str, object], events: Sequence[str]) -> None:
        """A frame is done: what there is to say of it, and what has happened."""
        with self._changed:
            self._state = "running"
            self._frame, self._facts = (frame.number, frame.time, frame.missing), facts
            self._events.extend(events)
            self._moments.append(time.monotonic())

    def show(self, picture: Image) -> None:
        """Make this the picture, BGR; it must not change any more."""
        with self._changed:
            self._picture, self._number = picture, self._number + 1
            self._changed.notify_all()

    def finish(self) -> None:
        """All frames are done, and results are being completed."""
        with self._changed:
            self._state = "finishing"

    def end(self, words: Sequence[str] | None) -> None:
        """The run has ended, as these lines say; without complete results if there are none."""
        with self._changed:
            if not self.ended:
                self._state, self._words = ("failed", ()) if words is None else ("ended", words)
            self._changed.notify_all()

    # --- asked by others ---

    @property
    def ended(self) -> bool:
        """Whether nothing will change any more."""
        return self._state in ("ended", "failed")

    def wait_for_end(self, seconds: float) -> bool:
        """Return when the run has ended, or after so many seconds; whether it has."""
        with self._changed:
            return self._changed.wait_for(lambda: self.ended, seconds)

    def status(self) -> dict[str, Any]:
        """What there is to say, as JSON; times in s."""
        with self._changed:
            number, seconds, missing = self._frame or (None, None, False)
            moments = self._moments
            span = moments[-1] - moments[0] if moments else 0.0
            return {
                "state": self._state,
                "title": self._title,
                "frame": number,
                "frames": self._n_frames,
                "time": seconds,
                "missing": missing,
                "frames_per_second": (len(moments) - 1) / span if span else None,
                "seconds_since": time.monotonic() - moments[-1] if moments else None,
                "facts": dict(self._facts),
                "stream": self._stream(),
                "events": list(self._events),
                "results": str(self._out),
                "words": list(self._words),
            }

    def picture(self, after: int | None = None, seconds: float = 0.0) -> Picture | None:
        """The newest picture, if one behind number `after` (or any) is there within so many seconds.

        All who look share one encoding, and there is none more often than once in `INTERVAL`.
        """
        with self._changed:
            if after is None:
                after = max(self._number - 1, 0)
            if not self._changed.wait_for(lambda: self._number > after or self.ended, seconds):
                return None
        with self._encoding:
            if self._encoded.number <= after:
                time.sleep(max(0.0, self._encoded_at + INTERVAL - time.monotonic()))
                with self._changed:
                    picture, number = self._picture, self._number
                if picture is None or number <= after:
                    return None
                self._encoded_at = time.monotonic()
                self._encoded = Picture(number, _jpeg(picture))
            return self._encoded


def _jpeg(picture: Image) -> bytes:
    scale = LONGEST_SIDE / max(picture.shape[:2])
    if scale < 1:
        picture = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


_log = logging.getLogger(__name__)

MOST_CONNECTIONS = 32
"""At the same time; further ones are hung up on."""

PATIENCE = 10.0  # s in which somebody has to have asked, and to take something of what is sent
AGAIN = 5.0  # s after which a picture is sent again if no other comes: who has gone away is noticed
EVERY = 1.0  # s between two states
FAREWELL = 1.0  # s at most for those who look to hear that the run has ended
SEND_BUFFER = 1 << 18  # bytes that a slow one is behind, beside the picture on its way

BOUNDARY = "picture"
PAGE = Path(__file__).parent / "templates" / "live.html"

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self' data:; connect-src 'self'; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Nobody keeps a picture, and no page of somebody else shows it."""


@contextmanager
def live_page(address: Address, running: Running) -> Iterator[str]:
    """Serve a run's page for as long as the block lasts; its address, and who can look if it is anybody.

    Those who look are told how the run has ended. It is an OSError if nothing can be served there.
    """
    server = _Server(address, running)
    thread = threading.Thread(target=server.serve_forever, args=(0.1,), name="live", daemon=True)
    thread.start()
    try:
        yield server.url + (" (everyone who can reach this machine can watch)" if server.open_to_all else "")
    finally:
        running.end(None)  # unless it has said how
        server.shutdown()
        server.server_close()
        server.wait(FAREWELL)


class _Server(ThreadingHTTPServer):
    """A thread for each connection, up to `MOST_CONNECTIONS`."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = sys.platform != "win32"  # where two could then hold one port

    def __init__(self, address: Address, running: Running) -> None:
        self.running = running
        self._free = MOST_CONNECTIONS
        self._changed = threading.Condition()
        try:
            family, _, _, _, place = socket.getaddrinfo(
                address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            self.address_family = family
            super().__init__((str(place[0]), int(place[1])), _Handler)
        except OSError as error:
            where = f"{address.host}:{address.port}"
            raise OSError(f"--live: got {where}, which cannot be opened: {error.strerror}") from None
        host = str(self.server_address[0])
        self.open_to_all = not ipaddress.ip_address(host).is_loopback
        self.names = {"localhost", address.host.lower()}
        if self.open_to_all:
            own = socket.gethostname().lower()
            self.names |= {own, f"{own.partition('.')[0]}.local"}
            host = own if ipaddress.ip_address(host).is_unspecified else host
        host = f"[{host}]" if ":" in host else host
        self.url = f"http://{host}:{self.server_address[1]}/"

    def server_bind(self) -> None:
        """Bind, without the name server that `HTTPServer` would ask."""
        socketserver.TCPServer.server_bind(self)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, if there are not too many."""
        with self._changed:
            if not self._free:
                self.shutdown_request(request)
                return
            self._free -= 1
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and make room for somebody else."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._changed:
                self._free += 1
                self._changed.notify_all()

    def wait(self, seconds: float) -> None:
        """Return when all connections have ended, or after so many seconds."""
        with self._changed:
            self._changed.wait_for(lambda: self._free == MOST_CONNECTIONS, seconds)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Whatever goes wrong with a connection is that one's affair."""
        _log.debug("live: %s", client_address, exc_info=True)

    def is_own(self, host: str) -> bool:
        """Whether a `Host` header names this machine.

        A name that somebody else has made point here (DNS rebinding) does not: his page would be allowed to
        read what this one shows. Addresses cannot be made to point elsewhere.
        """
        name = re.sub(r":[0-9]*$", "", host.strip().lower())
        if name in self.names:
            return True
        try:
            ipaddress.ip_address(name[1:-1] if name.startswith("[") and name.endswith("]") else name)
        except ValueError:
            return False
        return True


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: _Server
    server_version = "rsmcm"
    sys_version = ""
    timeout = PATIENCE

    def setup(self) -> None:
        """Keep little of what is on its way to somebody slow, and wait no longer for all that he asks."""
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        super().setup()
        self._is_late = False
        self._asking = threading.Timer(self.timeout, self._stop_listening)
        self._asking.daemon = True
        self._asking.start()

    def parse_request(self) -> bool:
        """Read the rest of what is asked, and whether it can be answered."""
        is_right = super().parse_request()
        self._asking.cancel()
        self.close_connection |= self._is_late
        return is_right and not self._is_late

    def finish(self) -> None:
        """End the connection."""
        self._asking.cancel()
        super().finish()

    def _stop_listening(self) -> None:
        self._is_late = True
        with suppress(OSError):  # he has gone away
            self.connection.shutdown(socket.SHUT_RD)

    def do_GET(self) -> None:
        """Answer, if it is one of ours."""
        if not self.server.is_own(self.headers.get("Host", "")):
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            return
        answer = self._responses.get(self.path.partition("?")[0])
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        with suppress(OSError):  # he has gone away
            answer(self)

    do_HEAD = do_GET  # noqa: N815

    def _refuse(self) -> None:
        self.send_response(HTTPStatus.METHOD_NOT_ALLOWED)
        self.send_header("Allow", "GET, HEAD")
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_POST = do_PUT = do_PATCH = do_DELETE = do_OPTIONS = _refuse  # noqa: N815

    def _page(self) -> None:
        self._send("text/html; charset=utf-8", PAGE.read_bytes())

    def _state(self) -> None:
        self._send("application/json", self._status())

    def _snapshot(self) -> None:
        picture = self.server.running.picture()
        if picture is None:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "No picture yet")
        else:
            self._send("image/jpeg", picture.data)

    def _states(self) -> None:
        """The state whenever it changes, at most once in `EVERY`, until the run has ended."""
        ended = not self._begin("text/event-stream")
        while not ended:
            ended = self.server.running.ended
            self.wfile.write(b"data: " + self._status() + b"\n\n")
            if not ended:
                self.server.running.wait_for_end(EVERY)

    def _stream(self) -> None:
        """Motion JPEG: the newest picture, as fast as it is taken, until the run has ended."""
        if not self._begin(f"multipart/x-mixed-replace; boundary={BOUNDARY}"):
            return
        running = self.server.running
        self.wfile.write(f"--{BOUNDARY}\r\n".encode())
        picture, ended = running.picture(), False
        while not ended:
            if picture is not None:
                head = f"Content-Type: image/jpeg\r\nContent-Length: {len(picture.data)}\r\n\r\n"
                # browsers show a picture when they see the line after it
                self.wfile.write(head.encode() + picture.data + f"\r\n--{BOUNDARY}\r\n".encode())
            ended = running.ended
            after = 0 if picture is None else picture.number
            picture = running.picture(after, AGAIN) or running.picture()

    _responses: ClassVar[dict[str, Callable[["_Handler"], None]]] = {
        "/": _page,
        "/stream.mjpg": _stream,
        "/snapshot.jpg": _snapshot,
        "/status.json": _state,
        "/status": _states,
    }

    def _status(self) -> bytes:
        return json.dumps(self.server.running.status(), allow_nan=False).encode()

    def _send(self, kind: str, content: bytes) -> None:
        if self._begin(kind, len(content)):
            self.wfile.write(content)

    def _begin(self, kind: str, length: int | None = None) -> bool:
        """Send the headers; whether anything is to follow."""
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()
        return self.command != "HEAD"

    def end_headers(self) -> None:
        """With those of every answer."""
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
        """Who asks for what is nothing to be said."""
        _log.debug(format, *arguments)
