"""The command `rsmcm`. Large modules are imported when a subcommand starts, so that help is fast."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from cyclopts import App, CycloptsError, Group, Parameter, Token

from .background.job import BackgroundJob, Camera
from .batch.job import batch
from .body.job import BodyJob
from .experiments import EXPERIMENTS, run_experiment, usual_folder
from .face.job import FaceJob
from .options.complaints import about_options, convert_strictly, one_line
from .options.job import Flag, Job
from .options.libraries import have_one_thread, opencv_hint, own_standard_error
from .options.settings import options_from_file
from .runs.interruption import SIGNALLED, Outcome
from .runs.messages import say_wrong, show_messages
from .shape.job import ShapeJob
from .structure.job import StructureJob

NOTHING_FOUND = 1
USAGE_ERROR = 2

app = App(
    name="rsmcm",
    help="Multi-chain tracking: dynamic models of a scene share latent features and correct each other.",
    version=version("rsmcm"),
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(converter=convert_strictly),
    config=options_from_file,
)
reproduce = App(
    name="reproduce", help="Reproduce figures of the papers, with targets beside the measured values."
)
app.meta.suppress_keyboard_interrupt = False
app.meta.group_parameters = Group("Global options", sort_key=2)

T = TypeVar("T")
Fields = Annotated[T, Parameter(name="*")]
"""A dataclass whose fields are the options."""
Figures = Annotated[Path, Parameter(help="Folder for the figures.")]


@app.command
def background(job: Fields[BackgroundJob]) -> int:
    """Separate moving objects from the background, and track them.

    Writes foreground masks, tracks.txt (MOT format), tracks.csv, background.png, summary.json and view.html.
    Ctrl-C ends the run with complete results of the processed frames.
    """
    from .background.application import run_background

    return _ended(run_background(job), job)


@app.command
def structure(job: Fields[StructureJob]) -> int:
    """Track points, and estimate their shape and the motion of the camera.

    Writes structure.ply, cameras.json, tracks.npz, predictions.npz, summary.json and view.html. All frames
    are held in memory, except with --engine recursive-bp. If the motion does not show depth (a static
    camera), the run reports this and writes no structure.ply. Ctrl-C ends the run with the results of the
    last complete round.
    """
    from .structure.application import run_structure

    return _ended(run_structure(job), job)


@app.command
def face(job: Fields[FaceJob]) -> int:
    """Track a face: its pose, deformation and texture.

    Writes poses.npz, texture.png, texture_variance.png, summary.json and view.html. Missing, unreadable and
    blank frames are predicted. A lost face is reported, and searched for. Ctrl-C ends the run with complete
    results of the processed frames.
    """
    from .face.application import run_face

    return _ended(run_face(job), job)


@app.command
def body(job: Fields[BodyJob]) -> int:
    """Track a person's upper body: the pose of head and arms in 3-D.

    Writes poses.npz, summary.json and view.html. The person should face the camera; long sleeves are best,
    since hands are found by the colour of the face. One person is tracked; other hands and objects in the
    colour of skin may be confused with the hands. Hidden parts, and missing, unreadable or blank frames, are
    predicted and marked. Ctrl-C ends the run with complete results of the processed frames.
    """
    from .body.application import run_body

    return _ended(run_body(job), job)


@app.command
def shape(job: Fields[ShapeJob]) -> int:
    """Learn the 3-D shape and motion of a deforming object from tracks of its points.

    Uses EM for probabilistic PCA of the shape, with a scaled orthographic camera. Writes shapes.npz (points
    in 3-D in every frame, poses, weights), model.npz (for rsmcm face), summary.json and view.html.
    """
    from .shape.application import run_shape

    return _ended(run_shape(job), job)


@app.command
def export(
    run: Path,
    *,
    to: Literal["coco", "cvat", "motchallenge", "movement", "video"],
    out: Path,
    overwrite: Flag = False,
) -> int:
    """Export the results of a finished run to a file for another tool.

    Parameters
    ----------
    run
        Folder of the run; for motchallenge also that of a batch, a run for each sequence.
    to
        coco: JSON with boxes, masks and identities of a background run. cvat: its MOT 1.1 (zip), which CVAT
        imports and --ground-truth reads. motchallenge: a folder with a text file for each sequence, as
        TrackEval and MOTChallenge take them. movement: netCDF of objects, a body or a face (needs
        rsmcm[xarray]). video: the video with the results drawn in.
    out
        File to write: .json, .zip, .nc or .mp4; for motchallenge a folder.
    overwrite
        Replace an existing file.
    """
    from .exports.export import run_export

    print(f"{run_export(run, to, out, overwrite=overwrite)}: {out}")
    return 0


@app.command
def demo(*, out: Path = Path("results/demo")) -> int:
    """Track a person who stands still in a generated street, with feedback and without.

    Parameters
    ----------
    out
        Folder for the scene and the results; results of an earlier demo are replaced.
    """
    from .demo import run_demo

    return _ended(run_demo(out))


@app.command
def doctor() -> int:
    """Report versions, threads, codecs, cameras, and what is missing for which command; run a self test.

    The self test tracks a person in a generated street, which takes ten seconds, and longer while loops are
    compiled for the first time. The exit code is 1 if something is missing that every run needs.
    """
    from .doctor import examine

    return 0 if examine() else NOTHING_FOUND


@app.command
def view(run: Path) -> int:
    """Open the page of a run in the browser.

    On a machine without a screen, it prints the path of the page.

    Parameters
    ----------
    run
        Folder of the run, or of a batch.
    """
    from .view.page import open_page

    print(open_page(run))
    return 0


@app.command
def validity(run: Path) -> int:
    """Report which chains of a finished run help each other, and why.

    Parameters
    ----------
    run
        Folder of the run, with the predictions that it recorded.
    """
    from .evaluation.validity import report_validity

    print(report_validity(run))
    return 0


@app.command
def events(run: Path, *, zones: Path) -> int:
    """Report the events in zones of a finished run of rsmcm background.

    Writes events.csv, events.html and the counts in summary.json, as --zones of the run itself would have;
    files of an earlier call are replaced.

    Parameters
    ----------
    run
        Folder of the run.
    zones
        TOML file with zones and lines of the image, or JSON of LabelMe.
    """
    from .events.page import run_events

    print(*run_events(run, zones), sep="\n")
    return 0


@app.command
def tune(
    *folders: Path,
    out: Path = Path("results/tune"),
    minutes: float = 60.0,
    folds: int = 3,
    seeds: int = 0,
    config: Path | None = None,
) -> int:
    """Search parameters of rsmcm background that are better on films with ground truth.

    Films are divided into folds; what is found without the films of a fold is judged on these. Writes
    tuned.toml for --config, index.html with what mattered, and study.log, with which the same command goes
    on. If the parameters found are no better on films that were left out, it says so and keeps those before.
    Needs rsmcm[tune].

    Parameters
    ----------
    folders
        Folders of films with masks, or of films with boxes, as of rsmcm reproduce films.
    out
        Folder for the results.
    minutes
        Time for the search.
    folds
        Number of folds, from 2 to the number of films.
    seeds
        Number of seeds of noise for each film. Default: videos as they are.
    config
        TOML file with the parameters to begin with.
    """
    from .tune.application import run_tune

    print(*run_tune(folders, out, minutes=minutes, folds=folds, seeds=seeds, config=config), sep="\n")
    return 0


def _experiment(name: str) -> Callable[..., None]:
    """What reproduces a figure, as a command, with the options that make a difference to it."""
    entry, folder = EXPERIMENTS[name], usual_folder(name)
    parallel = Parameter(parse=entry.parallel)

    def reproduced(
        *,
        out: Figures = folder,
        long: Annotated[Flag, Parameter(parse=bool(entry.long), help=entry.long)] = False,
        jobs: Annotated[int | None, parallel] = None,
        dask: Annotated[str | None, parallel] = None,
    ) -> None:
        """Reproduce a figure.

        Parameters
        ----------
        jobs
            Number of parallel processes. Default: the number of cores.
        dask
            Address of the scheduler of a Dask cluster to use instead.
        """
        from .runs.parallel import chosen_workers, working

        with working(chosen_workers(jobs, dask)):
            run_experiment(name, out, long=long)

    return reproduced


@reproduce.command
def compare(
    source: str,
    *,
    out: Figures = Path("results/compare"),
    ground_truth: Path | None = None,
    detections: Path | None = None,
    classes: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = (),
    camera: Camera = "fixed",
    roi: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    start: int = 1,
    stop: int | None = None,
    step: int = 1,
    config: Path | None = None,
    chain: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = (),
) -> int:
    """Compare methods on a video: background alone, feed-forward, RSMCM, and OpenCV's MOG2 and KNN.

    Writes index.html, results.json and images; with --ground-truth also errors and scores. The options are
    those of rsmcm background.

    Parameters
    ----------
    source
        A video file, or a folder or glob of images.
    ground_truth
        A MOT gt.txt, a folder with one, CVAT's zip of MOT 1.1, or a CDnet folder with groundtruth/.
    detections
        Boxes of a detector, for the chains.
    classes
        Names of the classes of detections to use, separated by commas. Default: all.
    camera
        Camera model of the chains: fixed or moving.
    roi
        Region of interest: x,y,width,height in px from 0, or an image that is not black inside.
    start
        First frame, counted from 1.
    stop
        Last frame, included; the end of the source if not given.
    step
        Take every n-th frame.
    config
        TOML file with options by name, and with parameters of the chains.
    chain
        Name of a chain of another package to connect as well; may be repeated.
    """
    from .experiments.compare import run_compare

    job = BackgroundJob(
        source, out=out, ground_truth=ground_truth, detections=detections, classes=classes, camera=camera,
        roi=roi, start=start, stop=stop, step=step, config=config, chain=chain,
    )  # fmt: skip
    return _ended(run_compare(job))


@reproduce.command
def films(
    *folders: Path,
    out: Figures = Path("results/films"),
    whole_film: Flag = False,
    seeds: int = 0,
    config: Path | None = None,
    jobs: int | None = None,
    dask: str | None = None,
) -> int:
    """Compare feedback with feed-forward and other methods on any films with ground truth.

    Of films with masks: F, precision and recall, also of OpenCV's MOG2 and KNN. Of films with boxes: MOTA,
    IDF1 and HOTA with the boxes of the detector (det/det.txt), without them, and of plain association of
    these boxes. Means over films, on how many each method is better, and p of Wilcoxon's signed-rank test.
    Writes index.html, results.json, plots, and measured.json: run again, the command measures what is
    missing or was measured with other code, films or parameters. A film that fails does not stop the others.

    Parameters
    ----------
    folders
        Folders of films, or of folders of films: CDnet's (input/, groundtruth/), or MOTChallenge's (img1/ or
        a video, gt/gt.txt or gt.txt, det/det.txt or det.txt).
    whole_film
        Also run --engine coordinate-ascent.
    seeds
        Number of seeds of noise (one grey level in a thousandth of the pixels), of which mean and standard
        deviation are given. Default: videos as they are.
    config
        TOML file with parameters of the chains.
    jobs
        Number of parallel processes. Default: the number of cores.
    dask
        Address of the scheduler of a Dask cluster to use instead.
    """
    from .experiments.films import run_films
    from .runs.parallel import chosen_workers, working

    with working(chosen_workers(jobs, dask)):
        return run_films(folders, out, whole=whole_film, seeds=seeds, config=config)


app.command(reproduce)
for name, entry in EXPERIMENTS.items():
    reproduce.command(_experiment(name), name=name, help=entry.about)
app.register_install_completion_command(help="Install completion for the shell that is running, and exit.")


app.command(batch)


def _ended(outcome: Outcome, job: Job | None = None) -> int:
    """Print the messages of a run, and return its exit code."""
    if job is not None:
        print(*outcome.words, *outcome.summary["notes"], f"results: {job.out / 'view.html'}", sep="\n")
    if outcome.signal is not None:
        return SIGNALLED + outcome.signal
    lost = None if outcome.lost is None else f"lost permanently: {outcome.lost}"
    if (wrong := lost or outcome.nothing) is None:
        return 0
    say_wrong(f"{outcome.summary['source']}: {wrong}")
    return NOTHING_FOUND


def _as_typed(_: object, tokens: Sequence[Token]) -> str:
    return tokens[0].value


@app.meta.default
def launch(
    *command: Annotated[str, Parameter(show=False, allow_leading_hyphen=True, converter=_as_typed)],
    threads: int | None = None,
    quiet: Flag = False,
    verbose: Flag = False,
    log: Path | None = None,
) -> int | None:
    """Run a command with the global options.

    Parameters
    ----------
    command
        Its name and its own options.
    threads
        Number of threads; results do not depend on it. Default: at most 2.
    quiet
        Print errors only.
    verbose
        Also print details of the run.
    log
        Append all messages, details of the run among them, to this file, with their times.
    """
    if quiet and verbose:
        raise ValueError("--quiet and --verbose: got both, expected one of them")
    function, bound, _ = app.parse_args(command, exit_on_error=False, print_error=False)
    show_messages(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING, log)
    try:
        if threads is not None:
            from ..models.numerics.threads import set_threads

            set_threads(threads)
            logging.getLogger("rsmcm").info("threads: %d", threads)
        # not None: what starts processes flushes it
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere if quiet else sys.stdout):
            code: int | None = function(*bound.args, **bound.kwargs)
    except ValueError as error:
        raise about_options(error, launch, function) from None
    return code


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; an error is one line on standard error and exit code 2."""
    if isinstance(sys.stdout, TextIOWrapper):  # what its encoding lacks must not end a run
        sys.stdout.reconfigure(errors="backslashreplace")
    have_one_thread()
    with own_standard_error():
        code = _exit_code(sys.argv[1:] if arguments is None else arguments)
    sys.exit(code)


def _exit_code(arguments: Sequence[str]) -> int:
    try:
        code: int | None = app.meta(
            arguments, exit_on_error=False, print_error=False, result_action="return_value"
        )
        return code or 0
    except (CycloptsError, ValueError, OSError, ImportError, AttributeError) as error:
        hint = opencv_hint(error)
        if isinstance(error, ImportError | AttributeError) and not hint:
            raise
        say_wrong(f"{one_line(error)}{hint}")
        return USAGE_ERROR
    except MemoryError:
        say_wrong("not enough memory for this run")
        return USAGE_ERROR
    except KeyboardInterrupt as stop:
        say_wrong(str(stop) or "interrupted")
        return SIGNALLED + getattr(stop, "signal", signal.SIGINT)


if __name__ == "__main__":
    main()
