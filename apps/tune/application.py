"""`rsmcm tune`: parameters for films of one's own, and whether they help on films that were not searched."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from ...models.files import write_text
from ..background.parameters import read_parameters
from ..experiments.films import find_films
from ..options.libraries import needed
from ..runs.progress import Progress
from ..view.page import Page, paragraph, table, write_page
from .search import FACTOR, LEAST, STUDY, Found, Task, Values, search

TUNED, PAGE = "tuned.toml", "index.html"

CONFIDENCE = 0.95
"""Of the interval of the mean gain, which has to lie above 0."""


@dataclass(frozen=True)
class Judged:
    """A film that a search has not seen: its measure with parameters of the start, and with those found."""

    name: str
    fold: int
    start: float
    tuned: float


def run_tune(
    folders: Sequence[Path],
    out: Path,
    *,
    minutes: float = 60.0,
    folds: int = 3,
    seeds: int = 0,
    config: Path | None = None,
) -> list[str]:
    """Search parameters on films in folds, judge each fold's on its left-out films, and write what is best.

    Each fold has an equal part of the time, and all films together, if the folds show a gain, another one.
    The folder has `study.log`, with which the same call goes on; `tuned.toml`, which `--config` takes, with
    the parameters of the start where others are no better; and `index.html`.

    Returns
    -------
    list[str]
        what was found, in sentences.

    Raises
    ------
    ValueError, OSError
        in one line, if options or films are wrong, optuna is missing, or something cannot be written.
    """
    try:
        needed("optuna", "tune")
    except ImportError as error:
        raise ValueError(str(error)) from error
    films = find_films(folders)
    if len({film.kind.name for film in films}) > 1:
        raise ValueError("folders: got films with masks and films with boxes, expected one kind of truth")
    if not 2 <= folds <= len(films):
        raise ValueError(f"folds: got {folds} for {len(films)} films, expected 2 or more, each with a film")
    if not minutes > 0:
        raise ValueError(f"minutes: got {minutes:g}, expected more than 0")
    if seeds < 0:
        raise ValueError(f"seeds: got {seeds}, expected 0 or more")
    task = Task(films, read_parameters(config), seeds)
    out.mkdir(parents=True, exist_ok=True)
    for name in (TUNED, PAGE):
        if (out / name).exists() and not (out / STUDY).exists():
            raise FileExistsError(f"{out / name}: no rsmcm tune has written it, expected another folder")

    seconds = 60 * minutes / (folds + 1)
    judged: list[Judged] = []
    searches: list[Found] = []
    with Progress("tune", None, unit="trials") as progress:
        for fold in range(folds):
            left_out = films[fold::folds]
            seen = [film for film in films if film not in left_out]
            found = search(task, seen, seconds, out, progress.update)
            searches.append(found)
            for film in left_out:
                start, tuned = (task.value(film, values) for values in (task.begin, found.values))
                judged.append(Judged(film.name, fold + 1, start, tuned))
        gain, margin = gain_of(judged)
        is_better = gain > margin
        if is_better:
            searches.append(search(task, films, seconds, out, progress.update))
    best = searches[-1].values if is_better else {}
    said = in_words(task.measure, gain, margin, is_better)
    text = "".join(f"# {line}\n" for line in said)
    write_text(out / TUNED, text + toml_text(task.parameters(best)))
    _write_page(out / PAGE, task, judged, searches, best, said)
    return [*said, f"parameters: {out / TUNED}", f"page: {out / PAGE}"]


def gain_of(judged: Sequence[Judged]) -> tuple[float, float]:
    """Mean gain over left-out films, and half the width of its interval (Student's t)."""
    gains = np.array([film.tuned - film.start for film in judged])
    error = float(gains.std(ddof=1)) / np.sqrt(len(gains))
    return float(gains.mean()), float(error * student_t.ppf((1 + CONFIDENCE) / 2, len(gains) - 1))


def in_words(measure: str, gain: float, margin: float, is_better: bool) -> list[str]:
    """What the folds show, in sentences."""
    seen = f"{measure} of films that were left out: {gain:+.4f} ± {margin:.4f} against the parameters before."
    if is_better:
        return [seen, "The parameters found are better; these are of a search on all films."]
    return [seen, "The parameters before are as good: they are kept."]


def toml_text(sections: Mapping[str, Mapping[str, Any]], above: str = "") -> str:
    """Sections of values, and sections in these, as TOML."""
    text = ""
    for section, values in sections.items():
        inner = {name: value for name, value in values.items() if isinstance(value, Mapping)}
        # scalars and lists of JSON are TOML's too
        own = [f"{name} = {json.dumps(value)}\n" for name, value in values.items() if name not in inner]
        text += f"\n[{above}{section}]\n{''.join(own)}" + toml_text(inner, f"{above}{section}.")
    return text


def _write_page(
    path: Path,
    task: Task,
    judged: Sequence[Judged],
    searches: Sequence[Found],
    best: Values,
    said: Sequence[str],
) -> None:
    told = [found.shares for found in searches if found.shares]
    shares = {key: float(np.mean([each[key] for each in told])) for key in task.begin} if told else {}
    rows: list[Sequence[object]] = [
        (key, shares.get(key, np.nan), value / FACTOR, value * FACTOR, value, best.get(key, value))
        for key, value in sorted(task.begin.items(), key=lambda item: -shares.get(item[0], 0.0))
    ]
    caption = (
        "Share of a parameter in the spread of the measure over trials (PED-ANOVA), mean over searches; told "
        f"from {LEAST} trials on. Ranges are from 1/{FACTOR:g} to {FACTOR:g} times the start."
    )
    films = [(film.name, film.fold, film.start, film.tuned, film.tuned - film.start) for film in judged]
    header = ("parameter", "share", "from", "to", "start", "written")
    of_films = f"{task.measure} ({task.method}) of each film with parameters of a search without it."
    helped = table(("film", "fold", "start", "tuned", "gain"), films, of_films)
    sections = [
        ("Does it help?", [*map(paragraph, said), helped]),
        ("What mattered", [table(header, rows, caption)]),
    ]
    trials = ", ".join(str(found.trials) for found in searches)
    cards = {"films": str(len(judged)), "measure": task.measure, "trials of each search": trials}
    write_page(path, Page("rsmcm tune", cards=cards, sections=sections))
