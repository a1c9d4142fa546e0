"""A run that somebody looks at: in a browser, over HTTP, while it goes on; and its results are the same."""

import json
import re
import socket
import subprocess
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes import Scene, sleeping_man

from ..conftest import Command
from ..support.browser import Browser, landmarks, reached_by_tab
from ..support.films import results, start, wait_until, write_film
from ..support.stream_server import Connection, StreamServer, serving

SIZE = (160, 120)
STAND, BEFORE = 100, 200  # frames


@pytest.fixture(scope="module")
def scene() -> Scene:
    """He walks in, stands, and walks out."""
    return sleeping_man(260, size=SIZE, stand=STAND, enter=20, car_leaves=260)


@dataclass
class Running:
    """A command that goes on, and its output."""

    process: subprocess.Popen[str]
    lines: list[str] = field(default_factory=list)

    @property
    def page(self) -> str:
        """Address of its live page."""
        wait_until(lambda: any(line.startswith("live:") for line in self.lines) or self.ended)
        return re.findall(r"live: (http://\S+)", "".join(self.lines))[0]

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    def status(self) -> dict[str, Any]:
        with urllib.request.urlopen(self.page + "status.json", timeout=20) as answer:
            status: dict[str, Any] = json.load(answer)
        return status


@contextmanager
def running(*arguments: object) -> Iterator[Running]:
    """A command with `--live 0`."""
    process = start(*arguments, "--live", 0)
    found = Running(process)

    def read() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            found.lines.append(line)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield found
    finally:
        if process.poll() is None:
            process.kill()
        reader.join()
        process.communicate()


def shown(page: Any, script: str) -> None:
    """Return when something is so on the page, whose policy forbids to evaluate text there."""
    wait_until(lambda: bool(page.evaluate(script)), 120)


def says(page: Any, text: str) -> None:
    """Return when the page's state begins like that."""
    shown(page, f"document.getElementById('state').textContent.startsWith({text!r})")


@pytest.mark.slow
def test_a_camera_in_the_browser(scene: Scene, browser: Browser, tmp_path: Path) -> None:
    """The page of a real stream, from its first frame to its end."""
    out = tmp_path / "out"
    # what has to be compiled is: a camera would not wait for it
    assert Command("background")(write_film(tmp_path / "film", size=SIZE), "--out", tmp_path / "before") == 0
    images: list[NDArray[np.uint8]] = [frame.image for frame in scene if frame.image is not None]
    images = [images[0]] * BEFORE + images
    server = StreamServer(images, [Connection(len(images))])
    with (
        serving(server.answer) as address,
        running("background", address, "--out", out) as run,
        browser.page(run.page) as page,
    ):
        says(page, "Running.")
        shown(page, "document.getElementById('picture').naturalWidth === 160")
        first = page.locator("#picture").screenshot()
        wait_until(lambda: page.locator("#picture").screenshot() != first)
        assert str(page.text_content("h1")).endswith(": recursive-bp")
        assert reached_by_tab(page) >= {"pause", "full", "save"}
        page.evaluate("document.activeElement.blur()")
        for pressed in ("true", "false"):
            page.keyboard.press("Space")
            assert page.get_attribute("#pause", "aria-pressed") == pressed
        assert run.status()["stream"]["gaps"] == []
        assert {"Picture", "Now"} <= {*landmarks(page)[1]}
        says(page, "The run has ended")
        assert str(out) in str(page.text_content("#state"))
        shown(page, "document.getElementById('controls').hidden")
        run.process.wait(60)
        assert run.process.returncode == 1, "a camera that hangs up is lost permanently"
    assert {"view.html", "film.mp4"} <= {path.name for path in out.iterdir()}


def test_results_are_the_same_bytes(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film", 60, (96, 72))
    assert Command("background")(film, "--out", tmp_path / "alone") == 0
    looked = 0
    with running("background", film, "--out", tmp_path / "watched") as run:
        with urllib.request.urlopen(run.page + "stream.mjpg", timeout=60) as stream:
            while stream.read(1000):
                looked += 1
        assert run.process.wait(60) == 0
    assert looked
    alone, watched = results(tmp_path / "alone"), results(tmp_path / "watched")
    assert alone.keys() == watched.keys()
    assert [name for name in alone if alone[name] != watched[name]] == []


def test_a_port_that_is_taken_is_told_before_anything_is_written(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    film, out = write_film(tmp_path / "film"), tmp_path / "out"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        message = Command("background").complaint(capfd, film, "--out", out, "--live", port)
    assert message.startswith(f"rsmcm: --live: got 127.0.0.1:{port}, which cannot be opened: Address already")
    assert not out.exists()
