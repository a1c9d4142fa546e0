"""Links from a page of a run to its other results."""

from collections.abc import Sequence
from pathlib import Path

LINKED = {
    "view.html": "film with what was found",
    "report.html": "report",
    "overlay.mp4": "video",
    "compare.html": "comparison",
    "tracks.csv": "tracks",
    "events.csv": "events",
    "structure.ply": "shape",
}
"""Files that people look at, and what the link says."""


def links_beside(page: Path, coming: Sequence[str] = ()) -> dict[str, str]:
    """What lies beside a page, or will come, by the names of the files: the text of the link."""
    return {
        name: text
        for name, text in LINKED.items()
        if name != page.name and (name in coming or (page.parent / name).exists())
    }
