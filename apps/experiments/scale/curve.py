"""Cost over size: what was measured, the power that fits, and what one more of them costs."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..expectations import Expectation
from ..record import Record, Table

HEADER = ("curve", "over", "size", "ms", "quartile", "other quartile", "limit, ms", "MB")
"""Of the table that keeps all curves; `of_table` reads it."""

CAPTION = "Every point of every curve; the time is the median over rounds."
FITTED = (
    "curve",
    "over",
    "from",
    "to",
    "power",
    "±",
    "fixed, ms",
    "each, µs",
    "bytes each",
    "over the limit",
)


@dataclass(frozen=True)
class Measured:
    """Cost at one size.

    Parameters
    ----------
    size
        how many.
    seconds, quartiles
        the median over rounds, and between which half of them lie.
    limit
        seconds that it takes at least.
    memory
        bytes that are held for all of them, NaN where nothing is.
    """

    size: float
    seconds: float
    quartiles: tuple[float, float]
    limit: float
    memory: float = math.nan

    @classmethod
    def of(cls, size: float, rounds: Sequence[float], limit: float, memory: float = math.nan) -> "Measured":
        """Of seconds of several rounds."""
        low, middle, high = np.percentile(rounds, (25, 50, 75)).tolist()
        return cls(size, middle, (low, high), limit, memory)


@dataclass(frozen=True)
class Curve:
    """Cost over size.

    Parameters
    ----------
    name, unit
        what is done, and what there is more and more of.
    points
        from few to many.
    """

    name: str
    unit: str
    points: Sequence[Measured]

    @property
    def power(self) -> tuple[float, float]:
        """The power of the size that fits the time best (least squares of logarithms), and its standard
        error."""
        size, seconds = np.log([(each.size, each.seconds) for each in self.points]).T
        size -= size.mean()
        power = float(size @ seconds / (size @ size))
        left = seconds - seconds.mean() - power * size
        degrees = len(self.points) - 2
        return power, float(np.sqrt(left @ left / degrees / (size @ size))) if degrees > 0 else math.nan

    @property
    def fixed_and_each(self) -> tuple[float, float]:
        """Seconds that do not depend on the size, and seconds of one more, by relative least squares.

        Where the first would be negative, it is 0.
        """
        size, seconds = np.array([(each.size, each.seconds) for each in self.points]).T
        terms = np.stack([np.ones(len(size)), size], axis=1) / seconds[:, None]
        fixed, each = np.linalg.lstsq(terms, np.ones(len(size)), rcond=None)[0].tolist()
        if fixed < 0:
            fixed, each = 0.0, float(terms[:, 1].sum() / (terms[:, 1] @ terms[:, 1]))
        return fixed, each

    @property
    def bytes_each(self) -> float:
        """Bytes of one more, at the largest size; NaN where nothing is held."""
        few, many = self.points[0], self.points[-1]
        return (many.memory - few.memory) / (many.size - few.size)

    def at(self, size: float) -> float:
        """Seconds at a size: on the straight lines between what was measured, in logarithms."""
        sizes, seconds = np.log([(each.size, each.seconds) for each in self.points]).T
        wanted = math.log(size)
        if wanted > sizes[-1]:
            return self.points[-1].seconds * size / self.points[-1].size
        return math.exp(float(np.interp(wanted, sizes, seconds)))

    def expectation(self, bound: float | None) -> Expectation:
        """The power, and what it should be at most."""
        power, error = self.power
        what = f"{self.name}: power of time in {self.unit}"
        return Expectation(what, power, "<=", bound, error, len(self.points), ratio=True)


def tables(curves: Sequence[Curve]) -> list[Table]:
    """What was fitted, and every point."""
    fitted: list[Sequence[object]] = []
    for each in curves:
        first, last = each.points[0], each.points[-1]
        fixed, one = each.fixed_and_each
        fitted.append(
            (each.name, each.unit, first.size, last.size, *each.power, 1e3 * fixed, 1e6 * one,
             each.bytes_each, last.seconds / last.limit)
        )  # fmt: skip
    points = [
        (each.name, each.unit, point.size, *(1e3 * value for value in (point.seconds, *point.quartiles)),
         1e3 * point.limit, point.memory / 1e6)
        for each in curves
        for point in each.points
    ]  # fmt: skip
    caption = (
        "Time to the power of the size that fits best, and, as a straight line, what does not depend on the "
        "size and what each one costs; the last column is how often the limit the largest takes."
    )
    return [Table(FITTED, fitted, caption), Table(HEADER, points, CAPTION)]


def of_record(record: Record) -> dict[tuple[str, str], Curve]:
    """The curves of a record, by name and unit.

    Raises
    ------
    ValueError
        if it has none.
    """
    for table in record.tables:
        if tuple(table.header) == HEADER:
            return _of_rows(table.rows)
    raise ValueError(f"{record.name}: got a record without curves")


def _of_rows(rows: Iterable[Sequence[Any]]) -> dict[tuple[str, str], Curve]:
    points: dict[tuple[str, str], list[Measured]] = {}
    for name, unit, size, *values in rows:
        # JSON knows no NaN
        middle, low, high, limit, memory = (math.nan if value is None else value for value in values)
        measured = Measured(size, middle / 1e3, (low / 1e3, high / 1e3), limit / 1e3, 1e6 * memory)
        points.setdefault((name, unit), []).append(measured)
    return {(name, unit): Curve(name, unit, of_curve) for (name, unit), of_curve in points.items()}
