"""Records joined, and compared: which ratios have become worse."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...evaluation.text_tables import rounded
from ..expectations import Expectation
from ..record import Provenance, Record, Table, joint_state

QUIET = 0.5
"""Cores that other processes may keep busy before speeds count as those of a loaded machine."""

SLACK = 0.25
"""Share by which a ratio may be worse than the worse quartile of the one before."""

PARTS_HEADER = ("part", "began", "seconds", "load before", "cores busy with others")


def joined(name: str, title: str, command: str, parts: Sequence[Record], root: Path) -> Record:
    """One record of several; figures of a part that other processes disturbed are marked.

    Parameters
    ----------
    name, title, command
        of the whole.
    parts
        in order.
    root
        checkout with the code that tracks: a whole of which a part was measured with other code is of an
        earlier state.

    Raises
    ------
    ValueError
        if there is no part.
    """
    if not parts:
        raise ValueError(f"{name}: got no part that was measured, expected one")
    expectations = [
        replace(each, loaded=bool(part.made.others > QUIET)) for part in parts for each in part.expectations
    ]
    rows = [
        (part.name, part.made.date, part.made.seconds, part.made.load, part.made.others) for part in parts
    ]
    tables = [each for part in parts for each in part.tables]
    caption = "The parts, each in a process of its own, and who else was at work."
    made = _all([part.made for part in parts], root)
    return Record(name, title, command, made, expectations, [*tables, Table(PARTS_HEADER, rows, caption)])


def _all(made: Sequence[Provenance], root: Path) -> Provenance:
    """Where and when all of them were made: the last one's, but for what adds up."""
    seconds = sum(each.seconds for each in made)
    modules = sorted({name for each in made for name in each.modules})
    return replace(
        max(made, key=lambda each: each.date),
        seconds=seconds,
        load=max(each.load for each in made),
        others=sum(each.others * each.seconds for each in made) / seconds,
        changed=any(each.changed for each in made),
        modules=modules,
        state=joint_state(root, modules) if all(each.is_of(root) for each in made) else "",
    )


def regressions(new: Record, old: Record) -> list[str]:
    """What got worse: a line for each ratio that did, and for each that is no longer measured.

    Only ratios of times that were measured together are compared, which do not depend on how fast a machine
    is, and only those of which something is wanted. Worse is what is beyond the worse quartile of before by
    more than `SLACK`; figures of a loaded machine are judged like all others, and are said to be so.
    """
    lines = []
    for before in old.expectations:
        if not (before.ratio and before.bound is not None):
            continue
        now = new.by_what.get(before.what)
        if now is None:
            lines.append(f"{before.what}: not measured any more, was {rounded(before.measured)}")
        elif _worse(now, before):
            loaded = ", on a loaded machine" if now.loaded else ""
            lines.append(
                f"{before.what}: {rounded(now.measured)}, was {rounded(before.measured)} "
                f"({'–'.join(map(rounded, before.quartiles or (before.measured,)))}){loaded}"
            )
    return lines


def _worse(now: Expectation, before: Expectation) -> bool:
    low, high = before.quartiles or (before.measured, before.measured)
    if not math.isfinite(now.measured):
        return math.isfinite(before.measured)
    if before.relation == "<=":
        return now.measured > high * (1 + SLACK)
    return now.measured < low / (1 + SLACK)
