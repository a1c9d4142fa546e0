"""The command `rsmcm`. Everything heavy is imported where a subcommand starts, so that help comes at once."""

import logging
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Group, Parameter, Token

from .complaints import about_options, convert_strictly, not_negative, one_line
from .io.sources.quiet import own_standard_error
from .opencv_packages import opencv_hint
from .runs.interruption import Outcome

STREAM_LOST = 1
USAGE_ERROR = 2
SIGNALLED = 128  # plus the number of the signal: 130 for Ctrl-C

app = App(
    name="rsmcm",
    help="Multi-chain tracking: dynamic models of a scene share latent features and correct each other.",
    version=version("rsmcm"),
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(converter=convert_strictly),
)
reproduce = App(name="reproduce", help="Reproduce figures of the papers, wanted values beside measured ones.")
app.command(reproduce)
app.register_install_completion_command(help="Install completion for the shell that is running, and exit.")
app.meta.suppress_keyboard_interrupt = False
app.meta.group_parameters = Group("Of every command", sort_key=1)

Flag = Annotated[bool, Parameter(negative="")]
From = Annotated[Path | None, Parameter(name="--from")]
Seed = Annotated[int, Parameter(validator=not_negative)]


@app.command
def background(
    source: str,
    *,
    out: Path,
    engine: Literal["recursive-bp", "feed-forward", "stand-alone"] = "recursive-bp",
    config: Path | None = None,
    roi: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    start: int = 1,
    stop: int | None = None,
    step: int = 1,
    resume: Flag = False,
    overwrite: Flag = False,
    every: int = 500,
    from_: From = None,
    masks: Literal["none", "png", "video"] = "png",
    ground_truth: Path | None = None,
    compare: Flag = False,
    seed: Seed = 0,
    reconnect: float | None = None,
) -> int:
    """Separate moving objects from the background, and track them.

    Writes foreground masks, tracks.txt (MOT format), background.png, overlay.mp4, summary.json and
    report.html. Ctrl-C ends the run with complete results of what was processed.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, the number of a camera, or an rtsp or http address.
    out
        Folder for the results.
    engine
        recursive-bp: background and objects correct each other. feed-forward: the background hears nothing of
        the objects. stand-alone: the background only, no tracks.
    config
        TOML file with parameters of the chains, in sections [background], [blobs] and [ground].
    roi
        Region of interest: x,y,width,height in px from 0, or a picture that is not black inside. Foreground
        outside is 0, and objects that stand outside are not reported.
    start
        First frame, counted from 1.
    stop
        Last frame, included; the end of the source if not given.
    step
        Take every n-th frame.
    resume
        Go on with the run whose results are in the folder, from its last saved state.
    overwrite
        Remove the results that are in the folder.
    every
        Save the state each time that so many frames are done.
    from_
        Begin with what a run over another film of the scene has learned, its background, tracks and
        identities: the state.npz of its results. A recording is taken to go on where that one ended.
    masks
        Foreground masks as foreground/bin000001.png and so on, as one lossless foreground.mkv, or none.
    ground_truth
        A MOT gt.txt or a folder that holds one, or a CDnet folder with groundtruth/.
    compare
        Also run the background by itself, feed-forward, MOG2 and KNN on the source, and draw the comparison.
    seed
        Of random numbers; recorded with the results.
    reconnect
        When a camera or stream is lost, try for so many seconds to get it back. The gap is missing frames.
    """
    from .background import application as application

    job = application.Job(
        source, out, engine, config, roi, masks, ground_truth, compare, start=start, stop=stop, step=step,
        resume=resume, overwrite=overwrite, every=every, learned=from_, seed=seed,
        reconnect=reconnect,
    )  # fmt: skip
    outcome = application.run_background(job)
    print(_in_words(outcome.summary))
    for note in outcome.summary["notes"]:
        print(note)
    print(f"results: {out / 'report.html'}")
    if compare and outcome.signal is None and outcome.lost is None:
        from .background.compare import run_compare

        outcome, lines = run_compare(job)
        if lines:
            print(f"comparison: {out / 'compare.html'}")
    return _ended(outcome)


@app.command
def structure(
    source: str,
    *,
    out: Path,
    coherence: Literal["second-order", "none"] = "second-order",
    association: Literal["dual-chain", "none"] = "dual-chain",
    start: int = 1,
    stop: int | None = None,
    step: int = 1,
    resume: Flag = False,
    overwrite: Flag = False,
    reconnect: float | None = None,
) -> int:
    """Track points, and find their shape and the motion of the camera.

    Writes structure.ply, cameras.json, tracks.npz, predictions.npz, summary.json and report.html, and
    overlay.mp4 where there are images. All frames are held in memory. Where the motion does not show depth (a
    static camera), that is said, and there is no structure.ply. Ctrl-C ends the run with the results of the
    last whole round.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, or a track file: an .npz with tracks (n_frames, n_points, 2)
        in px, NaN where a point is missing. At least 3 frames and 4 points.
    out
        Folder for the results.
    coherence
        second-order: the camera moves smoothly. none: every frame's camera is on its own.
    association
        dual-chain: shape and tracker correct each other, and tracks that show one point become one. none: the
        tracker hears nothing of the shape, every track is a point of its own.
    start
        First frame, counted from 1.
    stop
        Last frame, included; the end of the source if not given.
    step
        Take every n-th frame.
    resume
        Go on with the run whose results are in the folder, from its last saved round.
    overwrite
        Remove the results that are in the folder.
    reconnect
        When a camera or stream is lost, try for so many seconds to get it back. The gap is missing frames.
    """
    from .structure.application import StructureJob, run_structure

    outcome = run_structure(
        StructureJob(source, out, coherence, association, start, stop, step, resume, overwrite, reconnect)
    )
    summary = outcome.summary
    print(
        f"{summary['frames']} frames, {summary['points']} points from {summary['tracks']} tracks, "
        f"reprojection error {summary['reprojection_rmse_px']:.3g} px, shape: {summary['shape']}"
    )
    for note in summary["notes"]:
        print(note)
    print(f"results: {out / 'report.html'}")
    return _ended(outcome)


@app.command
def face(
    source: str,
    *,
    out: Path,
    model: Path | None = None,
    landmarks: Path | None = None,
    correspondences: Path | None = None,
    detector: Path | None = None,
    experts: int = 20,
    gain: float | Literal["learned"] = 0.1,
    seed: Seed = 0,
    start: int = 1,
    stop: int | None = None,
    step: int = 1,
    resume: Flag = False,
    overwrite: Flag = False,
    every: int = 500,
    from_: From = None,
    reconnect: float | None = None,
) -> int:
    """Track a face: its pose, deformation and texture.

    Writes overlay.mp4, poses.npz, texture.png, texture_variance.png, summary.json and report.html. Frames
    that are missing, unreadable or blank are predicted. Where the face is lost, that is said, and it is
    looked for again. Ctrl-C ends the run with complete results of what was processed.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, the number of a camera, or an rtsp or http address.
    out
        Folder for the results.
    model
        Morphable model: an .npz (of rsmcm shape, say), Candide-3 (.wfm), the Surrey model's folder or .bin,
        or an .obj. A small built-in face if not given.
    landmarks
        An .npy with landmarks (n_frames, n_landmarks, 2) in px, NaN where one is missing. Those of the first
        frame start the track. The others do not help it; it is measured by them. The first row belongs to the
        first frame that is processed, unless there are as many rows as the source has frames.
    correspondences
        Text that says which landmark is which of the model's: a line per pair, index from 0 = number from 1.
        Not needed where the landmarks are in the order of the model's landmarks or vertices.
    detector
        Without landmarks, the face is found by a detector: OpenCV's YuNet with this model file (.onnx), or
        the Haar cascade that OpenCV 4 brings along.
    experts
        How many hypotheses are tracked.
    gain
        How fast the texture follows the picture, from 0 (a template) to 1 (optic flow); learned: by
        each texel for itself.
    seed
        Of random numbers; recorded with the results.
    start
        First frame, counted from 1.
    stop
        Last frame, included; the end of the source if not given.
    step
        Take every n-th frame.
    resume
        Go on with the run whose results are in the folder, from its last saved state.
    overwrite
        Remove the results that are in the folder.
    every
        Save the state each time that so many frames are done.
    from_
        Begin with what a run over another film of the face has learned, its shape and texture: the
        state.npz of its results. A recording is taken to go on where that one ended.
    reconnect
        When a camera or stream is lost, try for so many seconds to get it back. The gap is missing frames.
    """
    from .face.application import FaceJob, run_face

    outcome = run_face(
        FaceJob(
            source, out, model, landmarks, correspondences, detector, experts, gain, start=start, stop=stop,
            step=step, resume=resume, overwrite=overwrite, every=every, learned=from_, seed=seed,
            reconnect=reconnect,
        )
    )  # fmt: skip
    summary = outcome.summary
    print(
        f"{summary['frames']} frames, {summary['frames_per_second']:.1f} a second, "
        f"{summary['lost_frames']} lost, {len(summary['reinitialised'])} re-initialisations"
    )
    if error := summary["error"]:
        print(
            f"error in {error['frames']} frames: mean {error['mean_px']:.3g} px, "
            f"worst {error['worst_px']:.3g} px in frame {error['worst_frame']}"
        )
    for note in summary["notes"]:
        print(note)
    print(f"results: {out / 'report.html'}")
    return _ended(outcome)


@app.command
def body(
    source: str,
    *,
    out: Path,
    detector: Path | None = None,
    head: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    joints: Path | None = None,
    samples: int = 1000,
    seed: Seed = 0,
    start: int = 1,
    stop: int | None = None,
    step: int = 1,
    resume: Flag = False,
    overwrite: Flag = False,
    every: int = 500,
    from_: From = None,
    reconnect: float | None = None,
) -> int:
    """Track a person's upper body: the pose of head and arms, in depth as well.

    Writes overlay.mp4, poses.npz, summary.json and report.html. The person should face the camera, best in
    long sleeves: hands are found by the colour of the face. It is one person's body with two hands; other
    hands and skin-coloured things compete with them. Parts that are hidden, and frames that are missing,
    unreadable or blank, are predicted, and it is said which. Ctrl-C ends the run with complete results of
    what was processed.

    Parameters
    ----------
    source
        A video file, a folder or glob of images, the number of a camera, or an rtsp or http address.
    out
        Folder for the results.
    detector
        The face is found by a detector: OpenCV's YuNet with this model file (.onnx), or the Haar cascade that
        OpenCV 4 brings along.
    head
        Instead of a detector: x,y,width,height in px of the head in the first frame, from chin to the top of
        the skull. It is then followed by its colour and edges.
    joints
        CSV file with the columns frame,joint,x,y: joints that were clicked in a few frames, from which the
        lengths of the person's arms are taken. Without it, proportions are usual ones. Joints: head, neck
        (between the shoulders), left_shoulder, left_elbow, left_hand, and right; left is the person's own.
    samples
        How many poses are drawn a frame.
    seed
        Of random numbers; recorded with the results.
    start
        First frame, counted from 1.
    stop
        Last frame, included; the end of the source if not given.
    step
        Take every n-th frame.
    resume
        Go on with the run whose results are in the folder, from its last saved state.
    overwrite
        Remove the results that are in the folder.
    every
        Save the state each time that so many frames are done.
    from_
        Begin with what a run over another film of the person has learned, lengths, colour and pose: the
        state.npz of its results. A recording is taken to go on where that one ended.
    reconnect
        When a camera or stream is lost, try for so many seconds to get it back. The gap is missing frames.
    """
    from .body.application import BodyJob, run_body

    outcome = run_body(
        BodyJob(
            source, out, detector, head, joints, samples, start=start, stop=stop, step=step, resume=resume,
            overwrite=overwrite, every=every, learned=from_, seed=seed, reconnect=reconnect,
        )
    )  # fmt: skip
    summary = outcome.summary
    shares = ", ".join(f"{name.replace('_', ' ')} {100 * s:.0f} %" for name, s in summary["seen"].items())
    print(f"{summary['frames']} frames, {summary['frames_per_second']:.1f} a second, seen: {shares}")
    for note in summary["notes"]:
        print(note)
    print(f"results: {out / 'report.html'}")
    return _ended(outcome)


@app.command
def shape(tracks: Path, *, bases: int, out: Path, overwrite: Flag = False) -> int:
    """Learn a deformable 3-D model of an object from tracks of its points.

    By EM for probabilistic PCA of the shape, seen by a scaled orthographic camera. `rsmcm face` and
    rsmcm.models.face.model_files read the model that it writes.

    Parameters
    ----------
    tracks
        .npy, or .npz with an array tracks or a single one: (n_frames, n_points, 2) px, NaN where missing.
    bases
        Number of morph bases, the mean shape among them: 2 or more.
    out
        The .npz file to write.
    overwrite
        Replace the file if it is there.
    """
    from .structure.shape import in_words, run_shape

    print(*in_words(run_shape(tracks, bases, out, overwrite=overwrite)), f"model: {out}", sep="\n")
    return 0


@app.command
def demo(*, out: Path = Path("results/demo")) -> int:
    """Track a person who stands still in a generated street, with feedback and without.

    Parameters
    ----------
    out
        Folder for the scene and the results; results of an earlier demo are replaced.
    """
    from .background.demo import run_demo

    return _ended(run_demo(out))


@app.command
def validity(run: Path) -> int:
    """Say which chains of a finished run help each other, and why.

    Parameters
    ----------
    run
        Folder of the run, with the predictions that it recorded.
    """
    from .evaluation.validity import report_validity

    print(report_validity(run))
    return 0


@reproduce.command
def sleeping_man(*, out: Path = Path("results/sleeping-man"), long: Flag = False) -> int:
    """Figures 1 and 7 of the RSMCM paper: a person stands still and stays foreground.

    Parameters
    ----------
    out
        Folder for the figures.
    long
        Also a person who stands for 1300 frames, and shadows of clouds.
    """
    from .experiments.reproduce.sleeping_man import reproduce_sleeping_man

    reproduce_sleeping_man(out, long)
    return 0


@reproduce.command
def pets(*, out: Path = Path("results/pets"), long: Flag = False) -> int:
    """Figures 8 and 11 of the RSMCM paper, on PETS2009 S2.L1.

    Parameters
    ----------
    out
        Folder for the figures.
    long
        Try all settings of MOG2 and KNN, and all clean-ups, instead of the middle ones.
    """
    from .experiments.reproduce.pets import reproduce_pets

    reproduce_pets(out, long)
    return 0


@reproduce.command
def highway(*, out: Path = Path("results/highway")) -> int:
    """Foreground of CDnet's highway, against its masks.

    Parameters
    ----------
    out
        Folder for the results.
    """
    from .experiments.reproduce.highway import reproduce_highway

    reproduce_highway(out)
    return 0


@reproduce.command
def cylinder(*, out: Path = Path("results/cylinder")) -> int:
    """Figures 9 and 10 of the RSMCM paper: a cylinder whose points are lost, found again and drift.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.cylinder import reproduce_cylinder

    reproduce_cylinder(out)
    return 0


@reproduce.command
def box(*, out: Path = Path("results/box")) -> int:
    """Figure 12 of the RSMCM paper, on CMU's hotel and a table top.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.box import reproduce_box

    reproduce_box(out)
    return 0


@reproduce.command
def shapes(*, out: Path = Path("results/shapes")) -> int:
    """Morph bases learned from tracks of points, against the true shapes of three public sets.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.shapes import reproduce_shapes

    reproduce_shapes(out)
    return 0


@reproduce.command
def talking_face(*, out: Path = Path("results/talking-face")) -> int:
    """A real film: landmarks carried by G-flow with a generic model, and with one learned from the film.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.talking_face import reproduce_talking_face

    reproduce_talking_face(out)
    return 0


@reproduce.command
def experts(*, out: Path = Path("results/experts")) -> int:
    """Figure 3a of the G-flow paper: one expert and several, flow and a slow texture, on quick motion.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.experts import reproduce_experts

    reproduce_experts(out)
    return 0


@reproduce.command
def gain(*, out: Path = Path("results/gain")) -> int:
    """Figure 3b of the G-flow paper: gains from template to flow, and learned ones.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.gain import reproduce_gain

    reproduce_gain(out)
    return 0


@reproduce.command
def recovery(*, out: Path = Path("results/recovery")) -> int:
    """Figure 4 of the G-flow paper: experts scattered about the pose find it.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.recovery import reproduce_recovery

    reproduce_recovery(out)
    return 0


@reproduce.command
def face_background(*, out: Path = Path("results/face-background")) -> int:
    """What a background and the surface's own occlusion are worth to G-flow.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.face_background import reproduce_face_background

    reproduce_face_background(out)
    return 0


@reproduce.command(name="body")
def body_figure(*, out: Path = Path("results/body-comparison")) -> int:
    """Figure 6 of the RSMCM paper: likelihood sampling with and without feedback, and CONDENSATION.

    Parameters
    ----------
    out
        Folder for the figures.
    """
    from .experiments.reproduce.body import reproduce_body

    reproduce_body(out)
    return 0


def _ended(outcome: Outcome) -> int:
    """The exit code of a run; a line says when its source was lost."""
    if outcome.signal is not None:
        return SIGNALLED + outcome.signal
    if outcome.lost is not None:
        print(f"rsmcm: {outcome.summary['source']}: lost for good: {outcome.lost}", file=sys.stderr)
        return STREAM_LOST
    return 0


def _in_words(summary: Mapping[str, Any]) -> str:
    """A run's summary in a few lines."""
    rate = summary["frames_per_second"]
    words = f"{summary['frames']} frames, {rate:.1f} a second, {summary['tracks']} tracks"
    if summary["missing_frames"]:
        words += f", {summary['missing_frames']} frames missing or unreadable"
    if summary["truncated"]:
        words += ", the source ends before its announced end"
    for group, values in (summary["metrics"] or {}).items():
        if isinstance(values, Mapping):
            listed = (
                f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
                for name, value in values.items()
            )
            words += f"\n{group}: {', '.join(listed)}"
        else:
            words += f"\n{group}: {values}"
    return words


def _as_typed(_: object, tokens: Sequence[Token]) -> str:
    return tokens[0].value


@app.meta.default
def launch(
    *command: Annotated[str, Parameter(show=False, allow_leading_hyphen=True, converter=_as_typed)],
    threads: int | None = None,
    quiet: Flag = False,
    verbose: Flag = False,
) -> int | None:
    """Run a command as its options and those of every command say.

    Parameters
    ----------
    command
        Its name and its own options.
    threads
        How many threads the loops over pixels use; the results do not depend on it. At most 2 if not given.
    quiet
        Print nothing but errors.
    verbose
        Also print what is found out and decided on the way.
    """
    if quiet and verbose:
        raise ValueError("--quiet and --verbose: got both, expected one of them")
    function, bound, _ = app.parse_args(command, exit_on_error=False, print_error=False)
    from .runs.progress import show_messages

    show_messages(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING)
    try:
        if threads is not None:
            from ..models.numerics.threads import set_threads

            set_threads(threads)
            logging.getLogger("rsmcm").info("threads: %d", threads)
        with redirect_stdout(None if quiet else sys.stdout):
            code: int | None = function(*bound.args, **bound.kwargs)
    except ValueError as error:
        raise about_options(error, launch, function) from None
    return code


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; whatever is wrong with it is one line on standard error and exit code 2."""
    if isinstance(sys.stdout, TextIOWrapper):  # what its encoding lacks must not end a run
        sys.stdout.reconfigure(errors="backslashreplace")
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
        print(f"rsmcm: {one_line(error)}{hint}", file=sys.stderr)
        return USAGE_ERROR
    except MemoryError:
        print("rsmcm: there is not enough memory for this run", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt as stop:
        print(f"rsmcm: {str(stop) or 'interrupted'}", file=sys.stderr)
        return SIGNALLED + getattr(stop, "signal", signal.SIGINT)


if __name__ == "__main__":
    main()
