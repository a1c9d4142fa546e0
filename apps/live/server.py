"""The page of a run that goes on, by HTTP: nothing but its picture and its state, which nobody can change."""

import ipaddress
import json
import logging
import re
import socket
import socketserver
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

from .address import Address
from .running import Running

_log = logging.getLogger(__name__)

MOST_CONNECTIONS = 32
"""At the same time; further ones are hung up on."""

PATIENCE = 10.0  # s for which somebody may neither ask nor take what is sent, before he is hung up on
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

    Those who look are told how the run has ended.

    Raises
    ------
    OSError
        in one line, if nothing can be served there.
    """
    server = _Server(address, running)
    thread = threading.Thread(target=server.serve_forever, args=(0.1,), name="live", daemon=True)
    thread.start()
    try:
        yield server.url + (" (anybody who reaches this machine can look)" if server.open_to_all else "")
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
        """Keep little of what is on its way to somebody slow."""
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        super().setup()

    def do_GET(self) -> None:
        """Answer, if it is one of ours."""
        if not self.server.is_own(self.headers.get("Host", "")):
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            return
        answer = self._answers.get(self.path.partition("?")[0])
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

    _answers: ClassVar[dict[str, Callable[["_Handler"], None]]] = {
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
