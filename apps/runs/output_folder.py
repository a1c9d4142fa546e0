"""The folder of a run's results: one run at a time writes there, and only what a run wrote is removed."""

import errno
import json
import os
import platform
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

from filelock import FileLock, Timeout

from ...models.files import UNFINISHED, naming, read_text
from ..io.files import PART, write_json
from .saved_run import STATE

MANIFEST = "manifest.json"
"""Which application's results these are, and the names of its files."""

LOCK = ".lock"
"""Locked while a run writes here; it stays, since removing a lock file lets two runs hold it."""

HOLDER = ".running.json"
"""Which run that is."""


class OutputFolder:
    """A folder that is locked for one run; see `output_folder`."""

    def __init__(self, path: Path, application: str) -> None:
        self.path = path
        self._application = application

    @property
    def holds_results(self) -> bool:
        """Whether a run has written here."""
        return (self.path / MANIFEST).exists()

    def begin(self, names: Sequence[str], *, resume: bool = False) -> None:
        """Remove the results of an earlier run, unless they are gone on with, and what a kill left over.

        `names` are files that the run may write, patterns of `glob` among them, known as its own from here
        on.

        Raises
        ------
        FileExistsError
            if one of these files is there that no run has written.
        OSError
            if the folder cannot be written to.
        """
        earlier = _listed(self.path)
        self._refuse_foreign(names, earlier)
        with naming(self.path), tempfile.TemporaryFile(dir=self.path):
            pass
        unfinished = {str(PurePosixPath(name).with_name(f"{UNFINISHED}*")) for name in [*earlier, *names]}
        for path in self.existing(sorted(unfinished)):
            path.unlink()
        if not resume:
            # the state first: what is left by a kill in between is not gone on with
            for path in sorted(self.existing(earlier), key=lambda path: path.name != STATE):
                path.unlink()
                if path.parent != self.path:
                    with suppress(OSError):  # the user may keep something there
                        path.parent.rmdir()
            earlier = []
        self._write_manifest(list(dict.fromkeys([*earlier, *names])))

    def add(self, names: Sequence[str]) -> None:
        """Make more files known as results of the run that is complete here; errors as of `begin`."""
        earlier = _listed(self.path)
        self._refuse_foreign(names, earlier)
        self._write_manifest(list(dict.fromkeys([*earlier, *names])))

    def drop_segments(self) -> None:
        """Remove the segments of files that are whole now."""
        for path in self.existing([name for name in _listed(self.path) if PART in name]):
            path.unlink()

    def end(self) -> None:
        """From here on only files that were really written are known as results."""
        listed = _listed(self.path)
        written = [name for name in listed if any(self.path.glob(name))]
        if not written:
            (self.path / MANIFEST).unlink(missing_ok=True)
        elif written != listed:
            self._write_manifest(written)

    def _refuse_foreign(self, names: Sequence[str], own: Sequence[str]) -> None:
        foreign = self.existing(names) - self.existing(own)
        if foreign:
            name = min(foreign).relative_to(self.path)
            raise FileExistsError(
                f"{self.path}: holds {name}, which no run has written: move it, or choose another folder"
            )

    def existing(self, names: Sequence[str]) -> set[Path]:
        """Files that are there under these names, patterns of `glob` among them."""
        return {path for name in names for path in self.path.glob(name) if not path.is_dir()}

    def _write_manifest(self, names: Sequence[str]) -> None:
        write_json(self.path / MANIFEST, {"application": self._application, "files": sorted(names)})


@contextmanager
def output_folder(
    path: Path, application: str, *, overwrite: bool = False, resume: bool = False, add: bool = False
) -> Iterator[OutputFolder]:
    """Lock a folder for a run of an application, and make it if need be.

    No result in it is changed before `OutputFolder.begin`. If that is never called, a folder that was made is
    removed again.

    Parameters
    ----------
    overwrite, resume, add
        results of an earlier run may be replaced, are gone on with, or get more files.

    Raises
    ------
    FileExistsError
        if the folder holds results, and none of these is given.
    ValueError
        if the results to go on with are another application's.
    OSError
        if it is no folder, another run writes there (it says which), or it cannot be made.
    """
    there = next((folder for folder in (path, *path.parents) if folder.exists()), None)
    if there is not None and not there.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected a folder", str(there))
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    lock = lock_of(path)
    try:
        folder = OutputFolder(path, application)
        if folder.holds_results and not (overwrite or resume or add):
            raise FileExistsError(f"{path}: already holds results: use --overwrite or --resume")
        if resume and folder.holds_results and application_of(path) != application:
            raise ValueError(
                f"--resume: {path} holds results of rsmcm {application_of(path)}, expected rsmcm "
                f"{application}"
            )
        if resume and folder.existing(_listed(path)) and not (path / STATE).exists():
            raise ValueError(f"--resume: {path / STATE} does not exist, start again with --overwrite")
        write_json(
            path / HOLDER,
            {"process": os.getpid(), "machine": platform.node(), "since": time.strftime("%Y-%m-%d %H:%M:%S")},
        )
        try:
            yield folder
        finally:
            folder.end()
    finally:
        with suppress(OSError):  # somebody may be reading it
            (path / HOLDER).unlink(missing_ok=True)
        lock.release()
        if made and not (path / MANIFEST).exists():
            (path / LOCK).unlink(missing_ok=True)
            for empty in made:
                with suppress(OSError):
                    empty.rmdir()


def lock_of(path: Path) -> FileLock:
    """The lock of a folder, which is now held, and to be released.

    Raises
    ------
    BlockingIOError
        if somebody else holds it; it says who, as far as that is known.
    """
    lock = FileLock(path / LOCK, timeout=0)
    try:
        with suppress(NotImplementedError):  # a file system without locks, and an old filelock
            lock.acquire()
    except Timeout:
        raise BlockingIOError(
            f"{path}: {_holder(path)} writes there: wait for it, or choose another folder"
        ) from None
    return lock


def was_cut_off(path: Path) -> bool:
    """Whether the process of a run that wrote into this folder has ended before the run did."""
    if not (path / HOLDER).exists():
        return False
    try:
        with FileLock(path / LOCK, timeout=0):
            return True
    except Timeout:
        return False


def _holder(path: Path) -> str:
    try:
        holder = json.loads((path / HOLDER).read_text(encoding="utf-8"))
        return f"process {holder['process']} on {holder['machine']}, since {holder['since']},"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return "another run"  # which has just begun or is about to end


def _manifest(path: Path) -> dict[str, Any]:
    """What the folder's manifest says; nothing where there is none.

    One that is none of ours is a ValueError: what it lists would be removed.
    """
    file = path / MANIFEST
    if not file.exists():
        return {"application": None, "files": []}
    try:
        content = json.loads(read_text(file, "expected a list of files"))
        application, files = content["application"], content["files"]
        inside = all(not Path(name).is_absolute() and ".." not in Path(name).parts for name in files)
        if not (isinstance(application, str) and isinstance(files, list) and inside):
            raise TypeError
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(
            f"{file}: got no list of a run's files: remove it, or choose another folder"
        ) from None
    return {"application": application, "files": files}


def _listed(path: Path) -> list[str]:
    files: list[str] = _manifest(path)["files"]
    return files


def application_of(path: Path) -> str | None:
    """Name of the application whose results a folder holds; `None` if it holds none."""
    application: str | None = _manifest(path)["application"]
    return application
