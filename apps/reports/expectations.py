"""What is wanted beside what was measured, as a table."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Expectation:
    """A number and the bound that it should keep.

    Parameters
    ----------
    what
        is measured, with its unit.
    measured
        its value.
    relation, bound
        what is wanted of it; `None` where nothing is, and the value only informs.
    """

    what: str
    measured: float
    relation: Literal["<=", ">="] = "<="
    bound: float | None = None

    @property
    def verdict(self) -> str:
        """`"pass"`, `"short"`, or nothing where nothing is wanted; NaN is short."""
        if self.bound is None:
            return ""
        holds = self.measured <= self.bound if self.relation == "<=" else self.measured >= self.bound
        return "pass" if holds else "short"

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """What, wanted, measured, verdict."""
        wanted = "" if self.bound is None else f"{self.relation} {self.bound:g}"
        return self.what, wanted, _rounded(self.measured), self.verdict


HEADER = ("measure", "wanted", "measured", "")


def in_columns(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Lay out a table as text; numbers are rounded and set to the right."""
    cells = [[_rounded(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    numeric = [all(_is_number(row[k]) for row in cells) for k in range(len(header))]
    widths = [max(len(line[k]) for line in (header, *cells)) for k in range(len(header))]

    def line(texts: Sequence[str]) -> str:
        padded = (
            text.rjust(width) if right else text.ljust(width)
            for text, width, right in zip(texts, widths, numeric, strict=True)
        )
        return "  ".join(padded).rstrip()

    return "\n".join([line(header), line(["-" * width for width in widths]), *map(line, cells)])


def print_tables(
    header: Sequence[str], lines: Sequence[Sequence[object]], expectations: Sequence[Expectation]
) -> None:
    """Print what was measured, and below it what is wanted of it."""
    print(in_columns(header, lines))
    print()
    print(in_columns(HEADER, [expectation.cells for expectation in expectations]))


def _rounded(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text in ("", "–")
    return True
