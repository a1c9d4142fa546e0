"""Self-contained HTML pages, put together from cards, tables, pictures and plots.

A page holds its pictures, plots and style itself, asks nothing of any network, and follows the reader's light
or dark setting. What is not `Markup` already is escaped.
"""

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...models.files import write_text
from .links import links_beside

Image = NDArray[np.uint8]

COLOURS = 64
"""Of each of the pictures that move: enough for dots and lines, in half of the bytes."""

Section = tuple[str, Sequence[Markup]]
"""Heading, which may be empty, and parts."""


def _rounded(value: object) -> object:
    return f"{value:.4g}" if isinstance(value, float | np.floating) else value


def _is_numeric(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def templates_in(folder: Path) -> jinja2.Environment:
    """Templates of HTML: what is not `Markup` is escaped, and names that are not given are errors."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )


_templates = templates_in(Path(__file__).parent / "templates")
_templates.filters["rounded"] = _rounded
_templates.tests["numeric"] = _is_numeric
_parts: Any = _templates.get_template("parts.html").module


def write_page(path: Path, title: str, sections: Iterable[Section]) -> None:
    """Write a page of sections as one HTML file.

    Raises
    ------
    OSError
        if the file cannot be written; nothing half-written stays behind.
    """
    write_text(path, _templates.get_template("page.html").render(title=title, sections=list(sections)))


def write_run_page(
    path: Path,
    title: str,
    summary: Markup,
    notes: Iterable[str],
    sections: Iterable[Section],
    parameters: Mapping[str, object],
    coming: Sequence[str] = (),
) -> None:
    """Write a page about a run: its summary and what is out of the ordinary first, every setting last.

    It links the run's other results, those that lie beside it and those that are `coming`.

    Raises
    ------
    OSError
        if the file cannot be written; nothing half-written stays behind.
    """
    beginning = [*links(path, coming), summary, *map(paragraph, notes)]
    settings = table(("parameter", "value"), flat(parameters))
    write_page(path, title, [("", beginning), *sections, ("Parameters", [settings])])


def links(path: Path, coming: Sequence[str] = ()) -> list[Markup]:
    """Links from a page to the run's other results, those that lie beside it and those that are `coming`."""
    beside = links_beside(path, coming)
    return [Markup(_parts.links(beside))] if beside else []


def cards(figures: Mapping[str, str]) -> Markup:
    """Values in large letters above their names."""
    return Markup(_parts.cards(figures))


def paragraph(text: str) -> Markup:
    """A paragraph of plain text."""
    return Markup(_parts.paragraph(text))


def flat(settings: Mapping[str, object], above: str = "") -> list[tuple[object, ...]]:
    """Name and value of every setting, mappings inside with dotted names."""
    rows: list[tuple[object, ...]] = []
    for name, value in settings.items():
        if isinstance(value, Mapping):
            rows += flat(value, f"{above}{name}.")
        else:
            rows.append((f"{above}{name}", value))
    return rows


def table(header: Sequence[str], rows: Iterable[Sequence[object]], caption: str = "") -> Markup:
    """A table; numbers are rounded to four digits and set to the right.

    Raises
    ------
    ValueError
        if a row has another number of cells than the header.
    """
    lines = list(rows)
    for row in lines:
        if len(row) != len(header):
            raise ValueError(f"rows: got a row of {len(row)} cells, expected {len(header)}: {row!r}")
    return Markup(_parts.table(header, lines, caption))


def picture(image: Image, caption: str = "") -> Markup:
    """A picture, `(height, width[, 3])` uint8, BGR."""
    return captioned(_inlined(image, caption), caption)


def moving_picture(images: Sequence[Image], seconds: float, caption: str = "") -> Markup:
    """Pictures of one size, `(height, width, 3)` uint8, BGR, each shown for so long, over and over."""
    from PIL import Image as Pillow

    first, *others = [Pillow.fromarray(image[..., ::-1]).quantize(COLOURS) for image in images]
    written = io.BytesIO()
    first.save(written, "gif", save_all=True, append_images=others, duration=round(1000 * seconds), loop=0)
    data = base64.b64encode(written.getvalue()).decode("ascii")
    return captioned(Markup(_parts.image("gif", data, caption)), caption)


def picture_grid(rows: Sequence[tuple[str, Sequence[Image]]], columns: Sequence[str]) -> Markup:
    """Pictures in named rows under named columns.

    Raises
    ------
    ValueError
        if a row has another number of pictures than there are columns.
    """
    lines = []
    for name, images in rows:
        if len(images) != len(columns):
            raise ValueError(f"rows: got {len(images)} pictures in row {name!r}, expected {len(columns)}")
        pictures = [
            _inlined(image, f"{name}, {column}") for image, column in zip(images, columns, strict=True)
        ]
        lines.append((name, pictures))
    return Markup(_parts.grid(lines, columns))


def captioned(content: Markup, caption: str) -> Markup:
    """A figure: its content, and its caption if there is one."""
    return Markup(_parts.captioned(content, caption))


def _inlined(image: Image, description: str) -> Markup:
    """An image as part of the page: JPEG, or PNG for pictures of few values, which JPEG would smear."""
    few = image.ndim == 2 and len(np.unique(image)) <= 16
    kind, options = ("png", []) if few else ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, 88])
    return Markup(_parts.image(kind, encoded(image, f".{kind}", options), description))


def encoded(image: Image, kind: str, options: Sequence[int] = ()) -> str:
    """A picture as a file of that kind (`.png`, `.jpg`) with OpenCV's options, in base 64.

    Raises
    ------
    ValueError
        if a picture of this form cannot be such a file.
    """
    done, data = cv2.imencode(kind, image, options)
    if not done:
        raise ValueError(f"image: got {image.shape} {image.dtype}, which cannot be stored as {kind}")
    return base64.b64encode(data.tobytes()).decode("ascii")
