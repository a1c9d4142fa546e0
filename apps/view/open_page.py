"""The page of finished results, shown in the reader's browser."""

import os
import sys
import webbrowser
from pathlib import Path

from .page import VIEW

PAGES = (VIEW, "index.html")
"""Of a run, of a batch of runs."""

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
"""One of these says where a browser may be shown, but on Windows and macOS, which need none."""


def page_of(folder: Path) -> Path:
    """The page that shows the results in a folder.

    Raises
    ------
    ValueError
        if there is none.
    """
    found = next((folder / name for name in PAGES if (folder / name).is_file()), None)
    if found is None:
        raise ValueError(
            f"{folder}: holds none of {', '.join(PAGES)}, expected the folder of a run's results"
        )
    return found


def open_page(folder: Path) -> Path:
    """Show the page of the results in a folder, where there is a screen; it is returned in any case.

    Raises
    ------
    ValueError
        if there is none.
    """
    page = page_of(folder)
    if sys.platform in ("win32", "darwin") or any(map(os.environ.get, _SCREENS)):
        webbrowser.open(page.resolve().as_uri())  # without a browser nothing happens, and the page is named
    return page
