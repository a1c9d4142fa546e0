"""Numbers of frames, and of other things, in words, and as periods."""

from collections.abc import Sequence

import numpy as np

MOST = 20  # that are listed


def listed(numbers: Sequence[object], thing: str = "frame") -> str:
    """For instance "frames 3, 4, 7"; long lists are cut short."""
    text = shortened(numbers)
    return f"{thing}{'s' if len(numbers) > 1 or ' ' in text else ''} {text}"


def shortened(numbers: Sequence[object]) -> str:
    """For instance "3, 4, 7"; of long lists the beginning."""
    return ", ".join(map(str, numbers[:MOST])) + (", …" if len(numbers) > MOST else "")


def periods(all_numbers: Sequence[int], chosen: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of every run of chosen frames among all of them, both in order."""
    inside = np.isin(np.array(all_numbers), chosen)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    return [(all_numbers[first], all_numbers[after - 1]) for first, after in edges.reshape(-1, 2).tolist()]


def listed_periods(found: Sequence[tuple[int, int]]) -> str:
    """For instance "frames 5 to 7, 20"."""
    return listed([f"{first} to {last}" if last > first else str(first) for first, last in found])


def notes_on_missing(numbers: Sequence[int]) -> list[str]:
    """A sentence about frames without anything to see, if there are any."""
    return [f"Missing, unreadable or blank, and only predicted: {listed(numbers)}."] if numbers else []
