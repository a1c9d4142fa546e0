"""`state.npz`: all that a run needs to go on, and what another run may learn from it."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...inference.engine import checkpoint
from ...inference.engine.recursive_bp import RunState

STATE = "state.npz"

OF_ALL = {"application": str, "settings": dict, "source": dict, "seconds": float, "finished": dict | None}
"""What is said of every saved run, and of which type."""

ABOUT = {
    "application": str,
    "settings": dict[str, Any],
    "source": dict[str, Any],
    "live": bool,
    "clock": float,
    "seconds": float,
    "before": list[int],
    "blank": list[int],
    "notes": list[str],
    "finished": dict[str, Any] | None,
}
"""The same of a run over a film, for `checkpoint`."""


class SavedRun:
    """What is saved of a run over a film, read from its file.

    Parameters
    ----------
    path
        of the file.
    application
        which one has saved it.
    settings
        of the run that goes on with it; `None` for one that only learns from it.

    Attributes
    ----------
    about
        plain JSON, see `ABOUT`: `source` is the fingerprint, `clock` s since 1970 when it was saved,
        `seconds` of work, `before` and `blank` numbers of frames, `finished` the summary.

    Raises
    ------
    ValueError
        if it is broken, another application's, or of a run with other settings.
    """

    def __init__(self, path: Path, application: str, settings: Mapping[str, Any] | None = None) -> None:
        self.path = path
        self._contents = checkpoint.read(path)
        about_of(self._contents, application, settings)
        self.about: dict[str, Any] = self._part("about", ABOUT)

    @property
    def number(self) -> int:
        """Of the last frame; 0 of a run that has not come beyond its beginning."""
        run = self._contents.plain("run")
        return int(run["number"]) if isinstance(run, dict) and isinstance(run.get("number"), int) else 0

    @property
    def shape(self) -> tuple[int, ...] | None:
        """Of its frames' images; `None` where there was none."""
        run = self._contents.plain("run")
        shape = run.get("shape") if isinstance(run, dict) else None
        if not isinstance(shape, list) or len(shape) not in (2, 3):
            return None
        return tuple(shape) if all(type(size) is int for size in shape) else None

    def state(self, chains: Mapping[str, Any]) -> RunState:
        """That of the engine, of these chains by name; ValueError if it is of others."""
        return RunState.restored(self._part("run", RunState.kinds(chains)))

    def memory(self, schema: Mapping[str, Any]) -> dict[str, Any]:
        """What the application has kept beside it; ValueError if that is no such thing as `schema` says."""
        memory: dict[str, Any] = self._part("memory", schema)
        return memory

    def _part(self, name: str, kinds: Mapping[str, Any]) -> Any:
        whole = self._contents
        arrays = {place: array for place, array in whole.arrays.items() if place.split("/")[0] == name}
        part = checkpoint.Contents(whole.path, {name: whole.plain(name)}, arrays)
        return checkpoint.load(part, {name: kinds})[name]


def save_run(
    path: Path,
    about: Mapping[str, Any],
    state: RunState,
    chains: Mapping[str, Any],
    memory: Mapping[str, Any],
    schema: Mapping[str, Any],
) -> None:
    """Write what `SavedRun` reads, everything or nothing."""
    values = {"about": dict(about), "run": state.saved(), "memory": dict(memory)}
    checkpoint.save(path, values, {"about": ABOUT, "run": RunState.kinds(chains), "memory": schema})


def about_of(
    contents: checkpoint.Contents, application: str, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What a saved run is about; ValueError if it is of another application or other settings."""
    about, path = contents.plain("about"), contents.path
    option = "--from" if settings is None else "--resume"
    if not isinstance(about, dict) or not all(
        isinstance(about.get(key), kind) for key, kind in OF_ALL.items()
    ):
        raise ValueError(f"{option}: {path} is no state of a run")
    if about.get("application") != application:
        raise ValueError(
            f"{option}: {path} is of rsmcm {about.get('application')}, expected rsmcm {application}"
        )
    if settings is not None:
        refuse_other("parameters", about["settings"], settings)
    return about


def words_of(
    path: Path, summary: Mapping[str, Any], in_words: Callable[[Any], Sequence[str]]
) -> Sequence[str]:
    """The summary of a finished run `in_words`; ValueError if it is none of this application's."""
    try:
        return in_words(summary)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path}: got another summary, {checkpoint.EXPECTED}") from error


def check_source(about: Mapping[str, Any], fingerprint: Mapping[str, Any]) -> None:
    """Refuse to resume with another source than that of the saved run, with a ValueError."""
    refuse_other("source", _identity(about["source"]), _identity(fingerprint))


def refuse_other(what: str, saved: Mapping[str, Any], now: Mapping[str, Any], above: str = "") -> None:
    """Refuse to resume where a value was another one: a ValueError names it, and what it is in."""
    for name in [*saved, *(name for name in now if name not in saved)]:
        before, after = saved.get(name), now.get(name)
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            refuse_other(what, before, after, f"{above}{name}.")
        elif before != after:
            raise ValueError(
                f"--resume: other {what} than in the saved run: {above}{name} was {before!r}, now {after!r}"
            )


def _identity(fingerprint: Mapping[str, Any]) -> dict[str, Any]:
    """What tells sources apart; one that was moved or renamed is the same."""
    unneeded = {"name"} if "sha256" in fingerprint else set()
    return {key: value for key, value in fingerprint.items() if key not in unneeded}
