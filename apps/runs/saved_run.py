"""`state.npz`: all that a run needs to go on, and what another run may learn from it."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from ...inference.engine import checkpoint
from ...inference.engine.recursive_bp import RunState
from .interruption import Interrupted

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


@dataclass(frozen=True, eq=False)
class SavedRun:
    """What is saved of a run over a film.

    Parameters
    ----------
    about
        plain JSON: `application`, `settings`, `source` (its fingerprint), whether that was `live`, the
        `clock` (s since 1970) when it was saved, `seconds` of work, numbers of the frames `before`
        the track starts and of `blank` ones, `notes`, and the summary if it is `finished`.
    state
        of the engine.
    memory
        what the application keeps beside it.
    """

    about: dict[str, Any]
    state: RunState
    memory: dict[str, Any]

    def save(self, path: Path, chains: Mapping[str, Any], kinds: Mapping[str, Any]) -> None:
        """Write everything, or nothing; `chains` and `kinds` say what states and memory are made of.

        Raises
        ------
        OSError
            if it cannot be written.
        """
        values = {"about": self.about, "run": self.state.saved(), "memory": self.memory}
        checkpoint.save(path, values, _kinds(chains, kinds))

    @classmethod
    def load(
        cls,
        path: Path,
        application: str,
        chains: Mapping[str, Any],
        kinds: Mapping[str, Any],
        settings: Mapping[str, Any] | None = None,
    ) -> Self:
        """Read what `save` wrote.

        Parameters
        ----------
        path
            of the file.
        application
            which one has saved it.
        chains, kinds
            as of `save`.
        settings
            of the run that goes on with it; `None` for one that only learns from it.

        Raises
        ------
        ValueError
            if it is broken, another application's, or of a run with other settings.
        OSError
            if it cannot be read.
        """
        contents = checkpoint.read(path)
        about_of(contents, application, settings)
        values = checkpoint.load(contents, _kinds(chains, kinds))
        return cls(values["about"], RunState.restored(values["run"]), values["memory"])


def _kinds(chains: Mapping[str, Any], kinds: Mapping[str, Any]) -> dict[str, Any]:
    return {"about": ABOUT, "run": RunState.kinds(chains), "memory": kinds}


def about_of(
    contents: checkpoint.Contents, application: str, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What a saved run is about; parameters as of `SavedRun.load`.

    Raises
    ------
    ValueError
        if it is of another application or other settings.
    """
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


@contextmanager
def saying_how_to_go_on(way: Callable[[], str | None]) -> Iterator[None]:
    """Have the line of a run that is interrupted say in which way it goes on, if there is one by then.

    Raises
    ------
    Interrupted
        with that line.
    """
    try:
        yield
    except Interrupted as stop:
        if way() is None:
            raise
        raise Interrupted(stop.signal, f"interrupted: {way()}") from None


def check_source(about: Mapping[str, Any], fingerprint: Mapping[str, Any]) -> None:
    """Refuse to resume with another source than that of the saved run.

    Raises
    ------
    ValueError
        if it is another one.
    """
    refuse_other("source", _identity(about["source"]), _identity(fingerprint))


def refuse_other(what: str, saved: Mapping[str, Any], now: Mapping[str, Any], above: str = "") -> None:
    """Refuse to resume where a value was another one.

    Raises
    ------
    ValueError
        naming it, by the names of the mappings that it is in.
    """
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
