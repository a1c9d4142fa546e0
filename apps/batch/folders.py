"""A folder of results for each film, whose name is made of the source's and stays in later batches."""

import glob
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from urllib.parse import urlsplit

from .sources import FILMS, TRACKS, Found

LONGEST = 80
"""Letters of a name."""


def folder_names(films: Sequence[Found], known: Mapping[str, str], taken: Iterable[str] = ()) -> list[str]:
    """Names of the folders of films, no two the same, also where a file system does not tell a from A.

    Parameters
    ----------
    films
        to be named, by the name in a list, or the last part of the source (`street` of `films/street.mp4`);
        where several have that, by as many parts as tell them apart, else by a number.
    known
        names that earlier batches have given, by source.
    taken
        names that nobody may have.

    Raises
    ------
    ValueError
        if a list gives one name to two cameras.
    """
    given = Counter(plain_name(film.name).casefold() for film in films if film.name is not None)
    for film in films:
        if film.name is not None and given[plain_name(film.name).casefold()] > 1:
            raise ValueError(f"{film.where}: name: got {film.name!r} twice, expected one for each camera")
    names = [plain_name(film.name) if film.name is not None else known.get(film.source) for film in films]
    for number, film in enumerate(films):
        if film.name is None and given[(names[number] or "").casefold()]:
            names[number] = None
    used = {name.casefold() for name in [*taken, *names] if name is not None}
    unnamed = [number for number, name in enumerate(names) if name is None]
    made = _telling_apart([_parts(films[number].source) for number in unnamed])
    for number, name in zip(unnamed, made, strict=True):
        free, count = name, 2
        while free.casefold() in used:
            free, count = f"{name}-{count}", count + 1
        used.add(free.casefold())
        names[number] = free
    return [name for name in names if name is not None]


def _telling_apart(paths: Sequence[Sequence[str]]) -> list[str]:
    """For each the last of its parts, and more of them as long as another one is called the same."""
    lengths = [1] * len(paths)
    while True:
        names = ["-".join(path[-length:]) for path, length in zip(paths, lengths, strict=True)]
        counts = Counter(name.casefold() for name in names)
        longer = [
            length + (counts[name.casefold()] > 1 and length < len(path))
            for name, path, length in zip(names, paths, lengths, strict=True)
        ]
        if longer == lengths:
            return [plain_name(name[-LONGEST:]) for name in names]
        lengths = longer


def _parts(source: str) -> list[str]:
    """Of a path, or of an address without user, password and query; the last without the suffix of a film."""
    if "://" in source:
        address = urlsplit(source)
        parts = [address.hostname or "", *address.path.split("/")]
    elif source.isdigit():
        parts = [f"camera-{source}"]
    else:
        parts = re.split(r"[/\\]", source)
    parts = [part for part in parts if part not in ("", ".", "..") and not glob.has_magic(part)]
    if parts and os.path.splitext(parts[-1])[1].lower() in FILMS | TRACKS:
        parts[-1] = os.path.splitext(parts[-1])[0]
    return [plain_name(part) for part in parts] or ["film"]


def plain_name(name: str) -> str:
    """A name that every file system and shell takes."""
    return re.sub(r"[^\w.-]+", "-", name.strip()).strip(".-") or "film"
