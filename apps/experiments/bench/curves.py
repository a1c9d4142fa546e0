"""Cost as curves: over pixels, what changes, objects, points, samples, experts, texels, threads and frames.

Each is drawn beside its physical limit: the time in which its memory is copied, read once and written once.
"""

import itertools
import math
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from ....chains import ArticulatedPose, FleshTracker, PointTracker
from ....chains.pixels.sleeping_blocks import BLOCK_ROWS
from ....inference import MultiChain
from ....models import Frame, PointTracks
from ....models.numerics.threads import set_threads
from ...background.application import build_model
from ...scenes import face
from ...scenes.crowd import crowd
from ..experiment import Findings, Plot
from ..record import Expectation
from .background import in_steps, preloaded, subtracting
from .people import EXPERTS as USUAL_EXPERTS
from .people import FACE_FRAMES, SIZE, BodyFilm, seconds_a_frame
from .people import TEXELS as USUAL_TEXELS
from .timing import in_turns, of_chains, over_frames

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINEAR, CONSTANT = 1.1, 0.05
"""Largest powers of time: in the frames so far it is to stay constant."""

PEER, LIMIT = "MOG2", "copying its memory"
BYTES = {"pixel": 18, "point": 146, "sample": 104, "texel": 12}
"""Of what one of them is read and written: picture, mean, variance, noise, second colour and its time of a
pixel; patch of a point, and a window of 11 x 11 px; 13 numbers of a pose; mean and variance of a texel of an
expert, and the picture there."""

N_WATCHED, GROWN = 1500, 32.0
"""Frames of the film over which time and memory are watched, and MB by which memory may grow."""

SIZES = ((320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160))
OF_CROWD = (1920, 1080)
OBJECTS = (1, 3, 10, 30, 100, 300)
ACTIVE_WARM_UP = 80  # frames, 25 a second: blocks of the background sleep after three seconds
ACTIVE, OF_NOISE, SQUARE = (0.01, 0.03, 0.1, 0.3, 1.0), (768, 576), 32  # shares that change; px
POINTS = (100, 1000, 10_000, 100_000)
SAMPLES = (250, 1000, 4000, 16_000)
EXPERTS = (1, 5, 20, 80)
TEXELS = (1000, 4000, 16_000)
THREADS = range(1, 1 + max(2, os.cpu_count() or 2))

ROUNDS, TURN, WARM_UP, CROWD_WARM_UP = 7, 2, 16, 30
"""All but the first in frames; a crowd of many takes longer to be found."""

SIDE, SHIFT = 2560, (1.4, -0.7)  # px, of a picture that has corners for all points, and from frame to frame


@dataclass(frozen=True)
class Curve:
    """Cost over size: what is done, the unit of size, and sizes with seconds, from few to many."""

    name: str
    unit: str
    points: Sequence[tuple[float, float]]

    @classmethod
    def of(cls, name: str, unit: str, rounds: Mapping[float, Sequence[float]]) -> "Curve":
        """Return the curve of medians of several rounds' seconds, by size."""
        return cls(name, unit, [(size, float(np.median(seconds))) for size, seconds in rounds.items()])

    @property
    def power(self) -> tuple[float, float]:
        """Power of the size that fits the time best (least squares of logarithms), and its standard error."""
        size, seconds = np.log(self.points).T
        size -= size.mean()
        power = float(size @ seconds / (size @ size))
        left = seconds - seconds.mean() - power * size
        degrees = len(self.points) - 2
        return power, float(np.sqrt(left @ left / degrees / (size @ size))) if degrees > 0 else math.nan

    @property
    def bound(self) -> float | None:
        """Upper bound that is wanted of the power; none of a peer, and over threads."""
        if self.name.startswith(PEER) or self.unit == "threads":
            return None
        return CONSTANT if self.unit == "frames so far" else LINEAR

    @property
    def expectation(self) -> Expectation:
        """The power, with its upper bound."""
        power, error = self.power
        what = f"{self.name}: power of time in {self.unit}"
        return Expectation(what, power, "<=", self.bound, error, len(self.points), ratio=True)


def curves() -> Findings:
    """Measure all curves: on one thread, but of bodies and faces on two, as they run."""
    set_threads(1)
    over_time, grown = over_frames_of_a_film(N_WATCHED)
    found = [
        *over_pixels(), *over_active_share(), *over_objects(), over_time, over_points(), over_samples(),
        of_face("experts", EXPERTS), of_face("texels", TEXELS), *over_threads(),
    ]  # fmt: skip
    expectations = [each.expectation for each in found]
    what = f"memory grown over the last four fifths of {N_WATCHED} frames, MB"
    expectations.append(Expectation(what, grown, "<=", GROWN))
    return Findings("Cost as curves", [], expectations, [plot([*found, *limits()])])


def plot(curves: Sequence[Curve]) -> Plot:
    """Plot a panel for each kind of size."""
    panels: dict[str, list[Curve]] = {}
    for each in curves:
        panels.setdefault(each.unit, []).append(each)
    rows, columns = -(-len(panels) // 4), 4
    return Plot("curves.png", partial(_draw, panels), (2.9 * columns, 2.4 * rows), "Time over size.")


def _draw(panels: Mapping[str, Sequence[Curve]], canvas: "Figure") -> None:
    from matplotlib.ticker import NullFormatter

    all_axes = canvas.subplots(-(-len(panels) // 4), 4, squeeze=False).reshape(-1)
    for axes, (unit, inside) in zip(all_axes, panels.items(), strict=False):
        for curve in inside:
            sizes, seconds = np.array(curve.points).T
            style = {"linestyle": ":", "color": "grey"} if curve.name == LIMIT else {"marker": "o"}
            axes.plot(sizes, 1e3 * seconds, markersize=3, label=curve.name, **style)
        axes.set(xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_minor_formatter(NullFormatter())
        axes.tick_params(labelsize=8)
        if sizes[-1] < 10 * sizes[0]:  # which decades alone do not tell
            axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
        axes.set_xlabel(unit, fontsize=9)
        axes.set_ylabel("ms", fontsize=9)
        axes.legend(fontsize=8, loc="upper left", handlelength=1, borderaxespad=0)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * 8 ** len(inside))  # room for the names
    for empty in all_axes[len(panels) :]:
        empty.set_axis_off()


# --- background and objects ---------------------------------------------------------------------------------


def over_pixels() -> list[Curve]:
    """Measure with four objects in pictures of any size."""
    films = ((w * h, list(crowd(4, WARM_UP + ROUNDS * TURN, (h, w)))) for w, h in SIZES)
    return _beside_mog2("", "pixels", films, WARM_UP)


def over_active_share() -> list[Curve]:
    """Measure where a share of the picture changes all the time, all over."""
    films = ((100 * share, _changing(share)) for share in ACTIVE)
    return _beside_mog2(", noise that changes", "% of the picture", films, ACTIVE_WARM_UP)


def _changing(share: float) -> list[Frame]:
    """A film of squares of noise that stand still at first; then a share of them changes in every frame."""
    rng, size = np.random.default_rng(0), OF_NOISE[::-1]
    scene = rng.uniform(40, 215, (*size, 3)).astype(np.float32)
    squares = rng.random((size[0] // SQUARE, size[1] // SQUARE))
    active = np.kron(squares <= np.quantile(squares, share), np.ones((SQUARE, SQUARE))) > 0
    frames = []
    for number in range(1, 1 + ACTIVE_WARM_UP + ROUNDS * TURN):
        image = scene + rng.standard_normal(scene.shape, np.float32)
        if number > ACTIVE_WARM_UP - WARM_UP // 2:
            image[active] = rng.uniform(0, 255, (np.count_nonzero(active), 3))
        frames.append(Frame(image.clip(0, 255).astype(np.uint8), number / 25, number))
    return frames


def _beside_mog2(
    what: str, unit: str, films: Iterable[tuple[float, Sequence[Frame]]], warm_up: int
) -> list[Curve]:
    """The background alone, all chains and MOG2 on films by a size."""
    spent = {size: _spent_beside_mog2(frames, warm_up, 1) for size, frames in films}
    return _curves_of(what, unit, spent)


def _spent_beside_mog2(frames: Sequence[Frame], warm_up: int, threads: int) -> Mapping[str, Sequence[float]]:
    steps = {
        "background alone": in_steps(build_model("stand-alone")),
        "all chains": in_steps(build_model()),
        PEER: subtracting(cv2.createBackgroundSubtractorMOG2(), threads),
    }
    return over_frames(steps, frames, TURN, warm_up)


def _curves_of(what: str, unit: str, spent: Mapping[float, Mapping[str, Sequence[float]]]) -> list[Curve]:
    names = next(iter(spent.values()))
    return [
        Curve.of(name + what, unit, {size: of_size[name] for size, of_size in spent.items()})
        for name in names
    ]


def over_threads() -> list[Curve]:
    """Measure the film of PETS on one thread and more."""
    frames, spent = preloaded(WARM_UP + ROUNDS * TURN), dict[float, Mapping[str, Sequence[float]]]()
    for count in THREADS:
        set_threads(count)
        spent[count] = _spent_beside_mog2(frames, WARM_UP, count)
    set_threads(1)
    return _curves_of(", PETS2009", "threads", spent)


def limits() -> list[Curve]:
    """Return for each kind of size in how much time its memory is copied, on one thread."""
    picture, of_crowd = math.prod(OF_NOISE), math.prod(OF_CROWD)
    looked_at = picture * BYTES["pixel"] / BLOCK_ROWS  # of blocks that sleep
    sizes: dict[str, dict[float, float]] = {
        "pixels": {w * h: BYTES["pixel"] * w * h for w, h in SIZES},
        "% of the picture": {100 * k: looked_at + k * picture * BYTES["pixel"] for k in ACTIVE},
        "objects": dict.fromkeys(OBJECTS, BYTES["pixel"] * of_crowd),
        "frames so far": dict.fromkeys((N_WATCHED // 10, N_WATCHED), BYTES["pixel"] * picture),
        "points": {n: BYTES["point"] * n for n in POINTS},
        "samples": {n: BYTES["sample"] * n for n in SAMPLES},
        "experts": {n: BYTES["texel"] * n * USUAL_TEXELS for n in EXPERTS},
        "texels": {n: BYTES["texel"] * n * USUAL_EXPERTS for n in TEXELS},
        "threads": dict.fromkeys(THREADS, BYTES["pixel"] * picture),
    }
    return [
        Curve.of(LIMIT, unit, {size: _copying(round(count)) for size, count in of_unit.items()})
        for unit, of_unit in sizes.items()
    ]


def _copying(count: int) -> Sequence[float]:
    """Seconds in which so many bytes are copied."""
    source, target = np.ones(count, np.uint8), np.ones(count, np.uint8)
    return in_turns({LIMIT: lambda: np.copyto(target, source)}, turn=5)[LIMIT]


def over_objects() -> list[Curve]:
    """Measure the blob tracker alone, and all chains."""
    width, height = OF_CROWD
    rounds: dict[str, dict[float, list[float]]] = {"blobs": {}, "whole": {}}
    for count in OBJECTS:
        frames = crowd(count, CROWD_WARM_UP + ROUNDS * TURN, (height, width))
        found = of_chains(build_model(), frames)[0][CROWD_WARM_UP:]
        for name, of_name in rounds.items():
            seconds = np.array([each[name] for each in found])
            of_name[count] = seconds.reshape(ROUNDS, TURN).mean(axis=1).tolist()
    called = (f"{name}, {width}x{height}" for name in ("tracker of blobs", "all chains"))
    return [Curve.of(name, "objects", each) for name, each in zip(called, rounds.values(), strict=True)]


def over_frames_of_a_film(count: int) -> tuple[Curve, float]:
    """Measure all chains over a film that runs to and fro, and the MB by which memory has grown.

    The growth is that after the first fifth, in which libraries and buffers are still taking theirs.
    """
    frames, step, process = preloaded(), in_steps(build_model()), psutil.Process(os.getpid())
    order = itertools.cycle([*frames, *reversed(frames[1:-1])])
    seconds, memory = np.empty(count), np.empty(count)
    for k, frame in enumerate(itertools.islice(order, count)):
        again = Frame(frame.image, (k + 1) / 10, k + 1)
        started = time.perf_counter()
        step(again)
        seconds[k] = time.perf_counter() - started
        memory[k] = process.memory_info().rss
    rounds, end = dict[float, list[float]](), len(frames) // 2
    while end <= count:
        rounds[end] = [float(np.median(block)) for block in np.array_split(seconds[end // 2 : end], ROUNDS)]
        end *= 2
    grown = float(memory[-1] - memory[count // 5]) / 2**20
    return Curve.of("all chains, PETS2009", "frames so far", rounds), grown


# --- points -----------------------------------------------------------------------------------------------


def over_points() -> Curve:
    """Measure the point tracker, with its search there and back."""
    noise = np.random.default_rng(0).standard_normal((SIDE + 64, SIDE + 64), np.float32)
    picture = sum(scale * cv2.GaussianBlur(noise, (0, 0), scale) for scale in (1.0, 3.0))
    texture = np.asarray(np.clip(128 + 60 * np.asarray(picture), 0, 255), np.uint8)
    frames = [Frame(_moved(texture, number), number / 25, number) for number in range(1, 4 + ROUNDS)]
    rounds: dict[float, list[float]] = {}
    for count in POINTS:
        tracker = PointTracker(n_points=count, spacing=4.0)
        found, state = of_chains(MultiChain().connect(tracker, PointTracks(patch_size=5)), frames)
        followed = int(state.states[tracker.name].known.alive.sum())
        rounds[followed] = [each["whole"] for each in found[3:]]
    return Curve.of(f"tracker of points, {SIDE}x{SIDE}", "points", rounds)


def _moved(texture: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    shift = np.array([[1.0, 0.0, number * SHIFT[0]], [0.0, 1.0, number * SHIFT[1] + 32]])
    moved = cv2.warpAffine(texture, shift, (SIDE, SIDE), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return np.asarray(moved, np.uint8)


# --- poses --------------------------------------------------------------------------------------------------


def over_samples() -> Curve:
    """Measure the chain of poses of a body: sampling, prior, likelihood."""
    set_threads(2)
    film, rounds = BodyFilm.load(), dict[float, list[float]]()
    for count in SAMPLES:
        pose = ArticulatedPose(film.body, count)
        model = MultiChain().connect(FleshTracker(film.body), film.parts).connect(pose, film.parts)
        rounds[count] = [each[pose.name] for each in of_chains(model, film.frames[: 3 + ROUNDS])[0][3:]]
    return Curve.of("poses of a body", "samples", rounds)


def of_face(unit: str, sizes: Sequence[int]) -> Curve:
    """Measure G-flow over experts or texels, with the other number fixed."""
    set_threads(2)
    scene, rounds = face(FACE_FRAMES, seed=0, size=SIZE), dict[float, list[float]]()
    for size in sizes:
        both = (size, USUAL_TEXELS) if unit == "experts" else (USUAL_EXPERTS, size)
        rounds[size] = [float(part.mean()) for part in np.array_split(seconds_a_frame(scene, *both), ROUNDS)]
    return Curve.of("G-flow, 640x480", unit, rounds)
