"""The commands `rsmcm batch background`, `structure`, `face` and `body`: what a batch is asked for.

The options of an application pass through a batch: they are derived from the application's job.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

from cyclopts import App, CycloptsError, Group, Parameter

from ..background.job import BackgroundJob
from ..body.job import BodyJob
from ..face.job import FaceJob
from ..options.complaints import convert_strictly, one_line
from ..options.job import Flag, Job
from ..options.settings import ALWAYS_TYPED, options_from_file
from ..structure.job import StructureJob

APPLICATIONS: Mapping[str, type[Job]] = {
    "background": BackgroundJob,
    "structure": StructureJob,
    "face": FaceJob,
    "body": BodyJob,
}

SUMMARY, INDEX = "summary.csv", "index.html"
"""Files over all films of a batch."""

OWN = ("source", "out", "resume", "overwrite", "live")
"""Fields of a job that a batch chooses itself, or cannot have for many films."""

Typed = Mapping[str, Any]
"""Options of an application with their values, by the names of a job's fields."""

T = TypeVar("T")
OfBatch = Annotated[T, Parameter(group=Group(ALWAYS_TYPED, sort_key=0))]


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Options of a batch.

    Parameters
    ----------
    out
        Folder for the results: one folder per video, summary.csv and index.html.
    jobs
        Number of videos at the same time, at least the number of live cameras. Default: the number of cores.
    dask
        Address of the scheduler of an existing Dask cluster, whose workers process the videos.
    overwrite
        Remove earlier results in the folders, and start again.
    only_print
        Print one shell command per video, and run nothing.
    """

    out: OfBatch[Path]
    jobs: OfBatch[int | None] = None
    dask: OfBatch[str | None] = None
    overwrite: OfBatch[Flag] = False
    only_print: Annotated[OfBatch[Flag], Parameter(name=("--print", "--dry-run"))] = False


def options_of(application: str) -> type[Any]:
    """The options of an application as a dataclass; those that were not given are `None`.

    It is derived from the application's job, so that names, kinds and help are the same. Values are judged
    when the job of a film is made of them.
    """
    kind = APPLICATIONS[application]
    hints = get_type_hints(kind, include_extras=True)
    options: list[tuple[str, Any, Any]] = []
    for each in fields(kind):
        if each.name not in OWN:
            shown = Parameter(show_default=_always(each.default)) if each.default else Parameter()
            options.append((each.name, Annotated[hints[each.name], shown], field(default=None)))
    documented = [type(each.__name__, (), {"__doc__": each.__doc__}) for each in kind.__mro__[:-1]]
    return make_dataclass(
        f"{application.capitalize()}Options",
        options,
        bases=tuple(documented),  # whose docstrings are the help
        namespace={"__module__": __name__},  # or it is taken for a built-in type
        frozen=True,
        kw_only=True,
    )


def _always(default: Any) -> Any:
    return lambda _: str(default)


def typed(options: Any) -> Typed:
    """The options that were given."""
    values = {each.name: getattr(options, each.name) for each in fields(options)}
    return {name: value for name, value in values.items() if value is not None}


def words_of(application: str, values: Typed) -> list[str]:
    """Options as they are typed: the names of fields or those of a TOML file, and their values."""
    hints = get_type_hints(APPLICATIONS[application], include_extras=True)
    words: list[str] = []
    for name, value in values.items():
        option = _option(name, hints.get(name))
        if isinstance(value, bool):
            words += [option] * value
        else:
            several = value if isinstance(value, list | tuple) else [value]
            words += [word for one in several for word in (option, str(one))]
    return words


def _option(name: str, hint: Any) -> str:
    given = [tuple(each.name or ()) for each in get_args(hint)[1:] if isinstance(each, Parameter)]
    return next((names[0] for names in given if names), f"--{name.replace('_', '-')}")


def job_of(application: str, words: Sequence[str]) -> Job:
    """The job that a command line asks for, without the name of the application; ValueError in one line."""
    kind: Any = APPLICATIONS[application]

    def asked(job: Any) -> None:
        """Nothing but its parameter counts."""

    asked.__annotations__["job"] = Annotated[kind, Parameter(name="*")]
    app = App(default_parameter=Parameter(converter=convert_strictly), config=options_from_file)
    app.default(asked)
    try:
        _, bound, _ = app.parse_args(list(words), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        raise ValueError(one_line(error)) from None
    job: Job = bound.arguments["job"]
    return job


HELP = """Run rsmcm {} on many videos or cameras.

Each video has its own folder of results; summary.csv and index.html list all of them. The same command, run
again, skips complete videos and continues interrupted ones. A video that fails does not stop the others, and
is reported at the end. The options of the single run apply to all videos.

Parameters
----------
sources
    Video files, folders of images, folders of videos, globs in quotation marks, addresses, or a TOML file
    that lists cameras.
"""

batch = App(name="batch", help="Run an application on many videos or cameras.")


def _over_many(application: str) -> Callable[..., int]:
    """An application over many films, as a command."""
    kind = options_of(application)
    given = Parameter(name="*")

    def over_many(*sources: str, batch: Annotated[Batch, given], options: Any = kind()) -> int:  # noqa: B008
        from .application import commands, run_batch

        if batch.only_print:
            print(*commands(application, sources, batch, options), sep="\n")
            return 0
        return run_batch(application, sources, batch, options).report(batch.out)

    over_many.__doc__ = HELP.format(application)
    over_many.__annotations__["options"] = Annotated[kind, given]
    return over_many


for application in APPLICATIONS:
    batch.command(_over_many(application), name=application)
