"""Tables as text, with numbers rounded."""

import math
from collections.abc import Iterable, Sequence


def in_columns(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as text; numbers are rounded and set to the right."""
    cells = [[rounded(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    numeric = [all(_is_number(row[k]) for row in cells) for k in range(len(header))]
    widths = [max(len(line[k]) for line in (header, *cells)) for k in range(len(header))]

    def line(texts: Sequence[str]) -> str:
        padded = (
            text.rjust(width) if right else text.ljust(width)
            for text, width, right in zip(texts, widths, numeric, strict=True)
        )
        return "  ".join(padded).rstrip()

    return "\n".join([line(header), line(["-" * width for width in widths]), *map(line, cells)])


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits, never rounded before its point; a dash if it is not finite."""
    if not math.isfinite(value):
        return "–"
    return f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:.0f}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text in ("", "–")
    return True
