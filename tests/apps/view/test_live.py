import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import count, islice
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from rsmcm.apps.options.job import Address
from rsmcm.apps.view import live
from rsmcm.apps.view.live import Running, live_page
from rsmcm.models.core.frame import Frame

from ...support.films import wait_until

LOOPBACK = Address("127.0.0.1", 0)


@pytest.fixture
def running(tmp_path: Path) -> Running:
    found = Running(tmp_path / "results")
    found.begin("street: recursive-bp", None, lambda: None)
    return found


@pytest.fixture
def page(running: Running) -> Iterator[str]:
    with live_page(LOOPBACK, running) as address:
        yield address


def ask(page: str, path: str = "/", method: str = "GET", host: str | None = None) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(urlsplit(page).netloc, timeout=10)
    connection.putrequest(method, path, skip_host=host is not None)
    if host:
        connection.putheader("Host", host)
    connection.endheaders()
    return connection.getresponse()


@contextmanager
def going_on(
    running: Running, size: tuple[int, int] = (64, 48), pause: float = 0.005
) -> Iterator[list[float]]:
    """A run that shows noise; the seconds that each frame has cost it."""
    stop, costs = threading.Event(), list[float]()
    noise = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3)).astype(np.uint8)

    def run() -> None:
        for number in count(1):
            if stop.wait(pause):
                return
            picture = np.roll(noise, number, axis=1)
            began = time.perf_counter()
            running.on_frame(Frame(picture, number / 25, number), {"tracks": 1}, ())
            running.show(picture)
            costs.append(time.perf_counter() - began)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield costs
    finally:
        stop.set()
        thread.join()


# --- what there is --------------------------------------------------


def test_page_state_and_picture(page: str, running: Running) -> None:
    assert ask(page, "/snapshot.jpg").status == 503, "none yet"
    with going_on(running):
        wait_until(lambda: ask(page, "/snapshot.jpg").status == 200)
        picture = ask(page, "/snapshot.jpg")
        assert picture.headers["Content-Type"] == "image/jpeg"
        data = np.frombuffer(picture.read(), np.uint8)
        assert cv2.imdecode(data, cv2.IMREAD_COLOR).shape == (48, 64, 3)
        said = json.load(ask(page, "/status.json"))
    assert said["title"] == "street: recursive-bp"
    assert said["state"] == "running"
    answer = ask(page)
    assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    text = answer.read().decode()
    assert "<main>" in text
    assert "http" not in text, "nothing of anybody else"
    assert ask(page, "/?again").status == 200


def parts(answer: http.client.HTTPResponse) -> Iterator[bytes]:
    """Pictures of a stream, as a browser cuts it."""
    assert answer.headers["Content-Type"] == "multipart/x-mixed-replace; boundary=picture"
    assert answer.readline() == b"--picture\r\n"
    while True:
        assert answer.readline() == b"Content-Type: image/jpeg\r\n"
        length = int(answer.readline().split(b":")[1])
        assert answer.readline() == b"\r\n"
        yield answer.read(length)
        assert answer.readline() == b"\r\n"
        if answer.readline() != b"--picture\r\n":
            return


def test_stream_is_motion_jpeg_until_the_run_ends(page: str, running: Running) -> None:
    with going_on(running):
        stream = parts(ask(page, "/stream.mjpg"))
        # one that is slow in coming is preceded by the last one again
        pictures = set(islice(stream, 20))
    assert len(pictures) >= 10
    for picture in pictures:
        assert cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR).shape == (48, 64, 3)
    running.end(["30 frames"])
    answer = ask(page, "/stream.mjpg")
    assert answer.read().count(b"--picture\r\n") >= 2, "the last picture, whole, and the end"


def test_states_come_until_the_run_has_ended(page: str, running: Running) -> None:
    answer = ask(page, "/status")
    assert answer.headers["Content-Type"] == "text/event-stream"
    first = answer.readline()
    running.end(["30 frames"])
    began = time.monotonic()
    lines = [line for line in answer.read().splitlines() if line]
    assert time.monotonic() - began < 0.9, "at once"
    said = [json.loads(line.removeprefix(b"data: ")) for line in [first, *lines]]
    assert [each["state"] for each in said] == ["starting", "ended"]
    assert said[-1]["words"] == ["30 frames"]


# --- what there is not --------------------------------------------------


@pytest.mark.parametrize(
    "path", ["/x", "/../running.py", "/templates/", "//etc/passwd", "/status.json/", "http://a/"]
)
def test_nothing_else(page: str, path: str) -> None:
    answer = ask(page, path, host="localhost")
    assert answer.status == 404
    assert b"href" not in answer.read()


@pytest.mark.parametrize("path", ["/", "/stream.mjpg", "/status", "/status.json"])
def test_head_is_the_headers_only(page: str, path: str) -> None:
    answer = ask(page, path, "HEAD")
    assert answer.status == 200
    assert answer.read() == b""
    assert answer.headers["Cache-Control"] == "no-store"
    assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8000", "127.0.0.1.evil.example", "", "[::1"])
def test_names_that_somebody_else_has_made_are_refused(page: str, host: str) -> None:
    for path in ("/", "/snapshot.jpg", "/status.json", "/stream.mjpg"):
        assert ask(page, path, host=host).status == 421


def sent(page: str, what: bytes) -> bytes:
    """All that is answered to some bytes, until it hangs up or says no more."""
    place = urlsplit(page)
    answer = b""
    connection = socket.create_connection((place.hostname, place.port), timeout=5)
    with connection, suppress(OSError):  # hung up on while it still talks
        connection.sendall(what)
        connection.shutdown(socket.SHUT_WR)
        while (some := connection.recv(1 << 16)) and len(answer) < 1 << 20:
            answer += some
    return answer


OWN = b"Host: localhost\r\n"
PATHS = (
    b"/../live.py", b"/%2e%2e/%2e%2e/etc/passwd", b"/%2E%2E%2Fetc%2Fpasswd", b"/..%2f..%2fetc/passwd",
    b"/%252e%252e/etc/passwd", b"/..\\..\\live.py", b"/%5c..%5clive.py", b"/%c0%ae%c0%ae/live.py", b"/%00",
    b"/\0", b"/status.json%00.html", b"/./status.json", b"/status.json;x", b"/templates/live.html",
    b"file:///etc/passwd", b"http://evil.example/", b"/%0d%0aSet-Cookie:%20a=b", b"/<script>alert",
)  # fmt: skip
PROBES = {
    **{b"GET " + path + b" HTTP/1.1\r\n" + OWN + b"\r\n": b"404" for path in PATHS},
    **{
        method + b" / HTTP/1.1\r\n" + OWN + b"Content-Length: 3\r\n\r\nabc": b"405"
        for method in (b"POST", b"PUT", b"PATCH", b"DELETE", b"OPTIONS")
    },
    **{method + b" / HTTP/1.1\r\n" + OWN + b"\r\n": b"501" for method in (b"TRACE", b"CONNECT", b"<b>")},
    b"GET / HTTP/1.1\r\n\r\n": b"421",
    b"GET / HTTP/1.1\r\nHost: evil.example\r\n" + OWN + b"\r\n": b"421",
    b"GET / HTTP/9.9\r\n" + OWN + b"\r\n": b"505",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n": b"505",
    b"\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03" + bytes(range(256)): b"400",
    b"no request of any kind\r\n\r\n": b"400",
    b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n": b"414",
    b"GET / HTTP/1.1\r\n" + OWN + b"A: " + b"a" * 70_000 + b"\r\n\r\n": b"431",
    b"GET / HTTP/1.1\r\n" + OWN + b"A: a\r\n" * 200 + b"\r\n": b"431",
    b"GET / HTTP/1.1\r\n" + OWN + b"Upgrade: websocket\r\nConnection: Upgrade\r\n\r\n": b"200",
    b"GET / HTTP/1.1\r\n" + OWN + b"Range: bytes=0-9999999999\r\n\r\n": b"200",
    b"GET / HTTP/1.1\r\n" + OWN + b"Transfer-Encoding: chunked\r\n\r\nffffffff\r\n": b"200",
    b"GET / HTTP/1.1\r\n" + OWN + b"Content-Length: -1\r\n\r\n": b"200",
    b"": b"",
    b"GET": b"400",
}


@pytest.mark.parametrize(("probe", "status"), PROBES.items(), ids=lambda each: repr(each[:40]))
def test_probes_get_nothing(page: str, probe: bytes, status: bytes) -> None:
    answer = sent(page, probe)
    head, _, body = answer.partition(b"\r\n\r\n")
    hung_up_on = not answer and (not probe or len(probe) > 60_000)  # while it talks
    assert hung_up_on or (status and status in answer[:500])
    assert (b"200 OK" in head) == (status == b"200")
    assert b"set-cookie" not in head.lower()
    assert b"<script>alert" not in body
    assert b"root:" not in body
    assert ask(page).status == 200


@pytest.mark.parametrize("begun", [b"", b"GET /stream.mjpg HTTP/1.1\r\n" + OWN])
def test_who_asks_slowly_is_hung_up_on(
    running: Running, monkeypatch: pytest.MonkeyPatch, begun: bytes
) -> None:
    """A byte now and then keeps nobody's place: all places are free again after `PATIENCE`."""
    monkeypatch.setattr(live._Handler, "timeout", 1.0)
    with live_page(LOOPBACK, running) as page, ExitStack() as opened:
        place = urlsplit(page)
        connections = [
            opened.enter_context(socket.create_connection((place.hostname, place.port), timeout=5))
            for _ in range(live.MOST_CONNECTIONS)
        ]
        for connection in connections:
            connection.sendall(begun)
        began = time.monotonic()
        while time.monotonic() < began + 1.6:
            for connection in connections:
                with suppress(OSError):
                    connection.sendall(b"A")
            time.sleep(0.2)
        wait_until(lambda: sent(page, b"GET / HTTP/1.1\r\n" + OWN + b"\r\n").startswith(b"HTTP/1.0 200"), 20)


def test_port_that_is_taken(page: str, tmp_path: Path) -> None:
    port = urlsplit(page).port or 0
    with (
        pytest.raises(
            OSError, match=rf"^--live: got 127.0.0.1:{port}, which cannot be opened: Address already"
        ),
        live_page(Address("127.0.0.1", port), Running(tmp_path)),
    ):
        pass
