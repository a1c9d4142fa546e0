"""The commands `rsmcm batch background`, `structure`, `face` and `body`."""

from collections.abc import Callable
from typing import Annotated, Any

from cyclopts import App, Parameter

from ..runs.interruption import SIGNALLED
from .job import APPLICATIONS, Batch, options_of

FAILED = 1

HELP = """Run rsmcm {} over many films or cameras.

Each has a folder of results, as of a run of its own; summary.csv and index.html are over all of them. Run
again, the same command leaves what is complete as it is, and goes on with what was broken off. A film that
fails is named at the end and stops no other. All options of the single run are for all films.

Parameters
----------
sources
    Video files, folders of images, folders of films, globs of them in quotation marks, addresses, or a TOML
    file that lists cameras.
"""

batch = App(name="batch", help="Run an application over many films or cameras, a folder of results for each.")


def _over_many(application: str) -> Callable[..., int]:
    """An application over many films, as a command."""
    kind = options_of(application)
    given = Parameter(name="*")

    def over_many(*sources: str, batch: Annotated[Batch, given], options: Any = kind()) -> int:  # noqa: B008
        from .application import commands, in_words, report_failures, run_batch

        if batch.only_print:
            print(*commands(application, sources, batch, options), sep="\n")
            return 0
        ended = run_batch(application, sources, batch, options)
        report_failures(ended)
        print(*in_words(ended, batch.out), sep="\n")
        return SIGNALLED + ended.signal if ended.signal is not None else FAILED * bool(ended.failed)

    over_many.__doc__ = HELP.format(application)
    over_many.__annotations__["options"] = Annotated[kind, given]
    return over_many


for application in APPLICATIONS:
    batch.command(_over_many(application), name=application)
