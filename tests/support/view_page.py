"""A page `view.html` in a browser: where something is on it, what is selected, what is drawn."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.view.film import Film, FilmWriter, Row, read_film
from rsmcm.apps.view.page import Page, write_page
from rsmcm.models.core.frame import Frame

from .browser import DESKTOP, Browser

if TYPE_CHECKING:
    import playwright.sync_api as playwright


def write_pages(
    folder: Path, frames: Iterable[Frame], drawn: Callable[[int], Row], page: Callable[[Film], Page]
) -> Film:
    """Write the page of frames, on the k-th of which `drawn(k)` is drawn."""
    with FilmWriter(folder, 25) as writer:
        for index, frame in enumerate(frames):
            writer.add(frame, lambda index=index: drawn(index))  # type: ignore[misc]
    film = read_film(folder)
    write_page(folder / "view.html", page(film))
    return film


class ViewPage:
    """A page that is shown.

    Parameters
    ----------
    page
        in the browser.
    size
        `(width, height)` px of the source.
    """

    def __init__(self, page: "playwright.Page", size: tuple[int, int]) -> None:
        self.page = page
        self._size = size

    def show(self, index: int) -> None:
        """Go to a frame, by its index from 0."""
        self.page.locator("#seek").fill(str(index))
        self.settle()

    def settle(self) -> None:
        """Until everything is drawn."""
        self.page.wait_for_timeout(100)

    @property
    def frame(self) -> int:
        """Number of the frame that is shown."""
        (number,) = re.findall(r"frame (\d+)", self.page.locator("#clock").text_content() or "")
        return int(number)

    def click(self, place: Iterable[float]) -> None:
        """Click on the film, at a place in px of the source with the pixels' centres at whole numbers."""
        self.page.evaluate("document.getElementById('film').scrollIntoView()")
        box = self.page.locator("#drawing").bounding_box()
        assert box is not None
        x, y = ((float(at) + 0.5) / side for at, side in zip(place, self._size, strict=True))
        self.page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])

    @property
    def selected(self) -> str | None:
        """What is selected; the panel and the timeline say the same."""
        who = self.page.locator("#details .who")
        name = who.text_content() if who.count() else None
        row = self.page.locator("[role=option][aria-selected=true] .label")
        assert (row.text_content() if row.count() else None) == name
        return name

    @property
    def details(self) -> Mapping[str, str]:
        """What is said of it."""
        names, values = (self.page.locator(f"#details {tag}").all_text_contents() for tag in ("dt", "dd"))
        return dict(zip(names, values, strict=True))

    def numbers(self, name: str) -> NDArray[np.float64]:
        """Those in a value of `details`."""
        return np.array(re.findall(r"-?\d+(?:\.\d+)?", self.details[name]), np.float64)

    def inked(self, canvas: str = "#drawing") -> int:
        """A number that differs with what is drawn: of px that are drawn on, each by its colour."""
        self.settle()
        script = f"""(() => {{
            const drawn = document.querySelector("{canvas}"), {{ width, height }} = drawn;
            const copy = new OffscreenCanvas(width, height).getContext("2d", {{ willReadFrequently: true }});
            copy.drawImage(drawn, 0, 0);
            return copy.getImageData(0, 0, width, height).data.reduce((sum, value) => sum + value, 0);
        }})()"""
        return int(self.page.evaluate(script))

    # --- the view that turns ---

    def in_space(self, centre: Iterable[float], reach: float) -> "Turned":
        """The view that turns, of places about `centre`."""
        return Turned(self, np.array(list(centre)), reach)


class Turned:
    """What is shown in space, with the angles (rad) by which this has turned it."""

    def __init__(self, shown: ViewPage, centre: NDArray[np.float64], reach: float) -> None:
        self._shown = shown
        self._centre, self._reach = centre, reach
        self.yaw = self.pitch = 0.0

    def _box(self) -> Any:
        space = self._shown.page.locator(".space")
        space.scroll_into_view_if_needed()  # what is said of a selection may have moved it down
        box = space.bounding_box()
        assert box is not None
        return box

    def drag(self, across: float, down: float) -> None:
        """Drag by so many px: 100 px are a rad, and what was touched goes with the hand."""
        box, mouse = self._box(), self._shown.page.mouse
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + across / 2, y + down / 2)
        mouse.move(x + across, y + down)
        mouse.up()
        self._shown.settle()
        self.yaw, self.pitch = self.yaw - across / 100, self.pitch + down / 100

    def place(self, point: Iterable[float]) -> NDArray[np.float64]:
        """Where a point is drawn, px of the window, and its depth."""
        box = self._box()
        x = np.array(list(point), np.float64) - self._centre
        # about the vertical axis, then about the horizontal one
        for angle, one, other in ((self.yaw, 0, 2), (-self.pitch, 1, 2)):
            sine, cosine = np.sin(angle), np.cos(angle)
            x[[one, other]] = [[cosine, sine], [-sine, cosine]] @ x[[one, other]]
        scale = 0.5 * min(box["width"], box["height"]) / self._reach
        middle = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
        return np.array([*(middle + scale * x[:2]), x[2]])

    def click(self, point: Iterable[float]) -> None:
        """Click where a point is."""
        x, y, _ = self.place(point)
        self._shown.page.mouse.click(x, y)


@contextmanager
def shown_page(
    browser: Browser,
    folder: Path,
    size: tuple[int, int],
    window: tuple[int, int] = DESKTOP,
    *,
    dark: bool = False,
) -> Iterator[ViewPage]:
    """The page of a folder, of a source of `size` (width, height) px, when it can be used."""
    with browser.page(folder / "view.html", window, dark=dark) as page:
        page.wait_for_function("(document.querySelector('video')?.readyState ?? 4) >= 2")
        yield ViewPage(page, size)
