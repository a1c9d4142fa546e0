"""Which films a batch is about (files, folders, globs, addresses, a TOML list of cameras), and their folders.

The name of a film's folder of results is made of its source, and stays in later batches.
"""

import glob
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ..io.sources.images import IMAGE_SUFFIXES, images_among, in_natural_order
from ..io.tracks import PICTURES
from ..options.settings import read_settings
from ..runs.output_folder import MANIFEST
from ..runs.saved_run import STATE
from .job import INDEX, SUMMARY, Typed

FILMS = frozenset(
    {".3gp", ".avi", ".flv", ".m2ts", ".m4v", ".mjpeg", ".mjpg", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg"}
    | {".mts", ".mxf", ".ogv", ".ts", ".webm", ".wmv"}
)
"""Suffixes of the files in a folder that are films; a file that is named may have any."""

TRACKS = frozenset({".npy", ".npz", ".mat"})
"""The same of track files, for `structure`."""

OF_RUN, OF_BATCH = (MANIFEST, STATE), (SUMMARY, INDEX)
"""Files by which the folders of their results are known."""

LIST = ".toml"
CAMERA = "camera"
"""The key of a list under which its cameras are."""


@dataclass(frozen=True)
class FilmSource:
    """A film or camera: its source as a run takes it, and options of its own.

    `name` is `None` where it is made of the source; `where` says for messages where it is listed.
    """

    source: str
    name: str | None = None
    options: Typed = field(default_factory=dict)
    where: str = ""

    @property
    def live(self) -> bool:
        """Whether it can only be watched as it happens: a camera, or an address that names no file."""
        if self.source.isascii() and self.source.isdigit():
            return not os.path.exists(self.source)
        scheme, separator, _ = self.source.partition("://")
        if not separator:
            return False
        return scheme.lower().startswith("rtsp") or _suffix(urlsplit(self.source).path) not in FILMS


def find_films(sources: Iterable[str], *, tracks: bool = False) -> list[FilmSource]:
    """All films that some sources name, each once, in their order; track files are films if `tracks` says so.

    Sources are video files, folders of images or of films, globs of them in quotation marks, addresses,
    numbers of cameras, and TOML files that list cameras: `[[camera]]` with `source`, perhaps `name`, and any
    option of the application; options at the top are for all of them.

    Raises
    ------
    ValueError
        if one names no film, or a list is wrong.
    OSError
        if there is no such file or folder, or it cannot be read.
    """
    kinds = FILMS | TRACKS if tracks else FILMS
    found: dict[str, FilmSource] = {}
    for source in sources:
        for each in _listed(Path(source)) if source.lower().endswith(LIST) else _named(source, kinds):
            if each.source not in found:
                found[each.source] = each
            elif each.name is not None:  # one camera with two settings is most likely one that was copied
                raise ValueError(f"{each.where}: got {each.source} twice, expected another source")
    if not found:
        raise ValueError("SOURCES is needed: videos, folders of them, or a TOML file that lists cameras")
    return list(found.values())


def _named(source: str, kinds: frozenset[str]) -> Iterator[FilmSource]:
    """The films that are meant by one that was typed."""
    path = Path(source)
    if "://" in source or (source.isascii() and source.isdigit() and not path.exists()):
        yield FilmSource(source)
    elif path.exists() or not glob.has_magic(source):
        yield from _on_disk(path, kinds)
    else:
        matches = [Path(match) for match in glob.glob(source, recursive=True)]
        if not matches:
            raise FileNotFoundError(f"{source}: matches nothing")
        matches = [path for path in matches if not _is_result(path)]
        if not matches:
            raise FileNotFoundError(f"{source}: matches nothing but results of rsmcm")
        if images_among(matches):
            yield FilmSource(os.path.abspath(source))
        for match in in_natural_order(path for path in matches if _suffix(path) not in IMAGE_SUFFIXES):
            try:
                yield from _on_disk(match, kinds)
            except FileNotFoundError:
                if not _holds(match, OF_BATCH):
                    raise


def _on_disk(path: Path, kinds: frozenset[str]) -> Iterator[FilmSource]:
    if path.is_dir():
        yield from _in_folder(path, kinds)
    elif not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder")
    elif _suffix(path) in IMAGE_SUFFIXES:
        raise ValueError(
            f"{path}: got a picture, expected a film: name its folder, or a glob in quotation marks"
        )
    else:
        yield FilmSource(os.path.abspath(path))


def _in_folder(folder: Path, kinds: frozenset[str]) -> Iterator[FilmSource]:
    """A folder of images is a film; one of films holds files and folders of images."""
    inside = [path for path in folder.iterdir() if not path.name.startswith(".")]
    films = [path for path in inside if path.is_file() and _suffix(path) in kinds]
    if images_among(inside):
        if films:
            raise ValueError(f"{folder}: holds images and films ({films[0].name}): name those that are meant")
        yield FilmSource(os.path.abspath(folder))
        return
    films += [
        path for path in inside if path.is_dir() and not _holds(path, OF_RUN) and images_among(path.iterdir())
    ]
    films += [path / PICTURES for path in inside if (path / PICTURES).is_dir()]
    if not films:
        raise FileNotFoundError(f"{folder}: the folder holds no images and no films")
    yield from (FilmSource(os.path.abspath(path)) for path in in_natural_order(films))


def _is_result(path: Path) -> bool:
    """Whether a file or folder is of a run's results, or over those of a batch."""
    if _holds(path, OF_RUN) or _holds(path.parent, OF_RUN):
        return True
    return path.name in OF_BATCH and _holds(path.parent, OF_BATCH)


def _holds(folder: Path, names: Iterable[str]) -> bool:
    return all((folder / name).exists() for name in names)


def _listed(path: Path) -> Iterator[FilmSource]:
    """The cameras of a list, with the options at its top and their own."""
    settings = read_settings(path)
    cameras = settings.pop(CAMERA, None)
    if not isinstance(cameras, list) or not cameras or not all(isinstance(each, dict) for each in cameras):
        raise ValueError(f"{path}: expected [[{CAMERA}]] for each camera, with source and its options")
    for number, own in enumerate(cameras, 1):
        where = f"{path}, camera {number}"
        options: dict[str, Any] = {**_underscored(settings), **_underscored(own)}
        source, name = options.pop("source", None), options.pop("name", None)
        if isinstance(source, int) and not isinstance(source, bool):
            source = str(source)
        if not isinstance(source, str) or not source:
            raise ValueError(f"{where}: source: got {source!r}, expected an address, a file or a number")
        if name is not None and not (isinstance(name, str) and name.strip()):
            raise ValueError(f"{where}: name: got {name!r}, expected a text")
        for key, value in options.items():
            if not isinstance(value, str | int | float | list):
                raise ValueError(f"{where}: {key}: got {value!r}, expected the value of an option")
        local = os.path.abspath(source) if os.path.exists(source) else source
        yield FilmSource(local, name, options, where if name is None else f"{where} ({name})")


def _underscored(options: Typed) -> dict[str, Any]:
    return {name.replace("-", "_"): value for name, value in options.items()}


def _suffix(path: str | Path) -> str:
    return os.path.splitext(path)[1].lower()


LONGEST = 80
"""Letters of a name."""


def folder_names(
    films: Sequence[FilmSource], earlier: Mapping[str, str], reserved: Iterable[str] = ()
) -> list[str]:
    """Names of the folders of films, no two the same, also where a file system does not tell a from A.

    A film is named by the name in a list, or the last part of the source (`street` of `films/street.mp4`);
    where several have that, by as many parts as tell them apart, else by a number. Names of
    `earlier` batches, by source, stay; those that are `reserved` are not given. A list that gives one name to
    two cameras is a ValueError.
    """
    given = Counter(plain_name(film.name).casefold() for film in films if film.name is not None)
    for film in films:
        if film.name is not None and given[plain_name(film.name).casefold()] > 1:
            raise ValueError(f"{film.where}: name: got {film.name!r} twice, expected one for each camera")
    names = [plain_name(film.name) if film.name is not None else earlier.get(film.source) for film in films]
    for number, film in enumerate(films):
        if film.name is None and given[(names[number] or "").casefold()]:
            names[number] = None
    used = {name.casefold() for name in [*reserved, *names] if name is not None}
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
