"""The RSMCM paper's experiments of §4.2 anew, with what is wanted of them beside what is measured."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..models.frame import Frame
from . import report
from .background import Engine
from .baselines import (
    CLEAN_UPS,
    SETTINGS,
    CleanUp,
    KalmanHungarian,
    Row,
    Setting,
    components,
    sweep_subtractors,
)
from .claims import HEADER, Claim, in_columns
from .compare import PRIORS, SHOWN_PRIOR, Gallery, write_comparison
from .data import data_folder
from .ground_truth import BoxTruth, MaskTruth, read_ground_truth
from .methods import Model
from .metrics import ErrorClasses, PixelScore, PixelScores, TrackScores, error_classes, evaluate_tracks
from .mosaic import mosaic
from .parameters import Parameters
from .progress import Progress
from .results import prepare_output, write_image
from .scenes import Scene, sleeping_man
from .sources import open_source

Image = NDArray[np.uint8]
Found = tuple[int, NDArray[np.float64]]
"""A frame's number and its components' boxes and areas `(n, 5)`."""

RAW = (CleanUp(), CleanUp(keep_shadows=True))
MEDIAN = CleanUp(median=5)
CHAINS: tuple[tuple[str, Engine], ...] = (("feed-forward", "feed-forward"), ("RSMCM", "recursive-bp"))


# --- the sleeping man ---------------------------------------------------------------------------------------

SEEDS = (0, 1, 2)


def reproduce_sleeping_man(out: Path, long: bool) -> None:
    """Figs. 1 and 7: a person stands still; alone, the background takes them in, together with blobs not.

    Parameters
    ----------
    out
        folder for figures and page.
    long
        also a person standing for 1300 frames, and shadows of clouds.

    Raises
    ------
    OSError
        if the folder cannot be written to.
    """
    out.mkdir(parents=True, exist_ok=True)
    pooled: dict[tuple[str, str], list[PixelScore]] = {}
    for seed in SEEDS:
        frames, truth = _rendered(sleeping_man(seed=seed), f"scene {seed}")
        for name, setting, score in _scores_of_scene(frames, truth, SETTINGS):
            pooled.setdefault((name, setting), []).append(score)
    best: dict[str, tuple[str, list[PixelScore]]] = {}
    for (name, setting), scores in pooled.items():
        if name not in best or _total(scores).f_measure > _total(best[name][1]).f_measure:
            best[name] = (setting, scores)
    lines: list[list[object]] = []
    for name, (setting, scores) in best.items():
        lines.append(
            [name, setting, *(score.total().f_measure for score in scores), _total(scores).f_measure]
        )
    error = {name: 1 - _total(scores).f_measure for name, (_, scores) in best.items()}
    claims = [
        Claim(f"1 - F, RSMCM over {name}", error["RSMCM"] / error[name], "<=", bound)
        for name, bound in (("feed-forward", 0.35), ("MOG2", 0.3), ("KNN", 0.3))
    ]
    if long:
        claims += _long_claims()
    header = ("method", "setting", *(f"F, seed {seed}" for seed in SEEDS), "F")
    _print_tables(header, lines, claims)

    figures = _sleeping_figures(sleeping_man(seed=SEEDS[0]))
    for name, picture in figures.items():
        write_image(out / f"{name.lower().replace('. ', '-')}.png", picture)
    captions = {"Fig. 1": "the background by itself", "Fig. 7": "background and blobs together"}
    pictures = [report.picture(picture, f"{name}: {captions[name]}") for name, picture in figures.items()]
    tables = [report.table(header, lines), report.table(HEADER, [claim.cells for claim in claims])]
    report.write_page(out / "index.html", "Sleeping man", [("", tables), ("Figures", pictures)])
    print(f"\npage: {out / 'index.html'}")


def _rendered(scene: Scene, label: str) -> tuple[list[Frame], list[NDArray[np.bool_]]]:
    frames, masks = [], []
    with Progress(label, len(scene)) as progress:
        for frame, mask in zip(scene, scene.masks, strict=True):
            frames.append(frame)
            masks.append(mask)
            progress.update()
    return frames, masks


def _scores_of_scene(
    frames: list[Frame], truth: list[NDArray[np.bool_]], settings: Sequence[Setting]
) -> Iterator[tuple[str, str, PixelScore]]:
    """Method, setting and score of everything that is tried on a scene."""
    labels = [np.where(mask, np.uint8(255), np.uint8(0)) for mask in truth]
    size = _size(frames)
    systems = [Model(name, engine, size) for name, engine in CHAINS]
    for system in systems:
        score = PixelScore()
        with Progress(system.name, len(frames)) as progress:
            for frame, label in zip(frames, labels, strict=True):
                score.add(frame.number, system.step(frame).foreground, label)
                progress.update()
        yield system.name, "", score

    def evaluate(number: int, mask: Image) -> PixelScore:
        one = PixelScore()
        one.add(number, mask, labels[number - 1])
        return one

    with Progress("MOG2, KNN", len(frames) * len(settings)) as progress:

        def images() -> Iterator[tuple[int, Image]]:
            for frame in frames:
                assert frame.image is not None
                yield frame.number, frame.image
                progress.update()

        numbers = range(1, len(frames) + 1)
        for row in sweep_subtractors(images, numbers, evaluate, settings, RAW):
            kept = ", shadows kept" if row.clean_up.keep_shadows else ""
            yield row.setting.method, row.setting.parameters + kept, _joined(row.values)


def _joined(scores: Iterable[PixelScore]) -> PixelScore:
    whole = PixelScore()
    for score in scores:
        whole.numbers += score.numbers
        whole.counts += score.counts
    return whole


def _total(scores: Iterable[PixelScore]) -> PixelScores:
    return _joined(scores).total()


def _long_claims() -> list[Claim]:
    """Scenes on which nothing was tuned."""
    claims = []
    for label, scene in (
        ("standing for 1300 frames", sleeping_man(1650, seed=7, stand=1300, car_leaves=1650)),
        ("shadows of clouds", sleeping_man(800, seed=8, clouds=True)),
    ):
        system = Model("RSMCM", "recursive-bp", scene.size)
        score = PixelScore()
        with Progress(label, len(scene)) as progress:
            for frame, mask in zip(scene, scene.masks, strict=True):
                found = system.step(frame).foreground
                score.add(frame.number, found, np.where(mask, np.uint8(255), np.uint8(0)))
                progress.update()
        blocks = [
            scores.f_measure
            for _, scores in score.blocks()
            if scores.true_positives + scores.false_negatives > 0
        ]
        claims.append(Claim(f"F, {label}", score.total().f_measure, ">=", 0.95))
        claims.append(Claim(f"least F of 250 frames, {label}", min(blocks), ">=", 0.85))
    return claims


def _sleeping_figures(scene: Scene) -> dict[str, Image]:
    """Figs. 1 and 7: input every thirtieth frame, background, foreground."""
    systems = {
        "Fig. 1": Model("alone", "stand-alone", scene.size, {"background": {"prior": SHOWN_PRIOR}}),
        "Fig. 7": Model("RSMCM", "recursive-bp", scene.size),
    }
    numbers: list[str] = []
    inputs: list[Image] = []
    made: dict[str, tuple[list[Image], list[Image]]] = {name: ([], []) for name in systems}
    with Progress("figures", len(scene)) as progress:
        for frame in scene:
            assert frame.image is not None
            shown = frame.number % 30 == 0
            for name, system in systems.items():
                found = system.step(frame)
                if shown:
                    made[name][0].append(system.background())
                    made[name][1].append(found.foreground)
            if shown:
                numbers.append(f"frame {frame.number}")
                inputs.append(frame.image)
            progress.update()
    return {
        name: mosaic(
            [("input", inputs), ("estimated background", backgrounds), ("foreground", masks)], numbers, 160
        )
        for name, (backgrounds, masks) in made.items()
    }


# --- PETS ---------------------------------------------------------------------------------------------------

FIRST_COUNTED = 40
"""Errors are counted in every tenth frame after 30."""
MIDDLE_SETTINGS = {
    f"history {history}, threshold {threshold}" for history in (200, 500) for threshold in (16, 32, 400, 800)
}
MIDDLE_AREAS = (100, 400, 800)
"""What is tried of MOG2 and KNN, and of clean-ups for everybody, without `--long`."""

# Which clean-up serves tracks best is not the one with the fewest errors, so they are chosen by themselves.
TRACK_CLEAN_UPS = tuple(
    CleanUp(keep_shadows, median, opening, closing)
    for keep_shadows, (median, opening, closing) in product((False, True), ((5, 0, 0), (0, 3, 9), (0, 3, 15)))
)
TRACK_AREAS = (100, 200, 400)
TRACKER_PARAMETERS = tuple(product((0.1, 0.3), (3, 5), (10, 20)))
"""Least overlap, hits from which a track counts, frames without a find after which it ends."""
FIRST_AREA, FIRST_PARAMETERS = 200, (0.1, 5, 20)
"""What settings and clean-ups are first compared with."""
N_FINALISTS = 2
"""So many of each method, by IDF1 and by MOTA, are tried with all areas and parameters without `--long`."""


class ModelSubtractor:
    """A model as something that turns picture after picture into masks."""

    def __init__(
        self, engine: Engine, size: tuple[int, int], rate: float, parameters: Parameters | None = None
    ) -> None:
        self._model = Model("", engine, size, parameters)
        self._rate = rate
        self._count = 0

    def apply(self, image: Image, /) -> Image:
        """Take the next picture; return 0 background, 255 foreground."""
        self._count += 1
        return self._model.step(Frame(image, self._count / self._rate, self._count)).foreground


def reproduce_pets(out: Path, long: bool) -> None:
    """Figs. 8 and 11 on PETS2009 S2.L1: errors of extracted components, and tracks.

    Parameters
    ----------
    out
        folder for figures and page.
    long
        try all settings of MOG2 and KNN and all clean-ups instead of the middle ones.

    Raises
    ------
    OSError
        if the sequence cannot be found or fetched, or the folder cannot be written to.
    """
    folder = data_folder("pets2009-s2l1")
    truth = read_ground_truth(folder)
    assert isinstance(truth, BoxTruth)
    prepare_output(out, overwrite=True)
    video = str(folder / "vtest.avi")
    with open_source(video) as source:
        size, rate, n_frames = source.size, source.rate, source.n_frames

    settings = [each for each in SETTINGS if long or each.parameters in MIDDLE_SETTINGS]
    clean_ups = [each for each in CLEAN_UPS if long or each.min_area in MIDDLE_AREAS]
    chains = [Setting(name, "", partial(ModelSubtractor, engine, size, rate)) for name, engine in CHAINS]
    alone = [
        Setting(
            f"stand-alone, P(B) = {prior}",
            "",
            partial(ModelSubtractor, "stand-alone", size, rate, {"background": {"prior": prior}}),
        )
        for prior in PRIORS
    ]
    everything = [*alone, *chains, *settings]
    wanted = range(FIRST_COUNTED, (n_frames or 795) + 1, 10)
    with Progress("errors", (n_frames or 795) * len(everything)) as progress:
        rows = list(
            sweep_subtractors(
                lambda: _images(video, progress),
                wanted,
                lambda number, mask: error_classes(mask, truth.at(number)),
                everything,
                clean_ups,
            )
        )
    ranked: dict[str, list[Row[ErrorClasses]]] = {}
    for row in sorted(rows, key=lambda row: _sum(row).errors):
        ranked.setdefault(row.setting.method, []).append(row)

    gallery = Gallery()
    tracks = _tracks_of_chains(video, truth, size, gallery)
    usual = _tracks_of_usual(video, truth, settings, long)
    best = [
        max((tried for tried in usual if tried.method == name), key=lambda tried: tried.scores.idf1)
        for name in ("MOG2", "KNN")
    ]
    tracks |= {tried.method: tried.scores for tried in best}

    errors = {name: _sum(ranked[name][0]) for name in (each.method for each in everything)}
    best_usual = max(best, key=lambda tried: tried.scores.idf1)
    most_accurate = max(usual, key=lambda tried: tried.scores.mota)
    dual = tracks["RSMCM"]
    least = min(errors["MOG2"].errors, errors["KNN"].errors)
    claims = [
        Claim(
            "missed + ghosts, RSMCM over the best of MOG2 and KNN", errors["RSMCM"].errors / least, "<=", 0.7
        ),
        Claim(
            "missed + ghosts, RSMCM over feed-forward",
            errors["RSMCM"].errors / max(errors["feed-forward"].errors, 1),
            "<=",
            0.8,
        ),
        Claim("IDF1, RSMCM over the best usual tracker", dual.idf1 / best_usual.scores.idf1, ">=", 1.25),
        Claim("id switches, over the same", dual.switches / max(best_usual.scores.switches, 1), "<=", 0.5),
        Claim(
            "MOTA, RSMCM over the usual tracker with the best",
            dual.mota / most_accurate.scores.mota,
            ">=",
            1.0,
        ),
    ]
    lines = [
        {
            "method": name,
            "clean-up": _described(ranked[name][0].setting, ranked[name][0].clean_up),
            "missed pedestrians": found.missed_pedestrians,
            "missed vehicles": found.missed_vehicles,
            "ghosts": found.ghosts,
            "total": found.errors,
            **_track_cells(tracks.get(name)),
        }
        for name, found in errors.items()
    ]
    header = list(dict.fromkeys(name for line in lines for name in line))
    usual_header = ("usual tracker", "method", "parameters", *_track_cells(dual))
    usual_lines = [
        [label, tried.method, tried.described, *_track_cells(tried.scores).values()]
        for label, tried in (*(("best IDF1", tried) for tried in best), ("best MOTA", most_accurate))
    ]
    print(in_columns(usual_header, usual_lines), end="\n\n")
    _print_tables(header, [[line.get(name, "") for name in header] for line in lines], claims)
    tables = [
        report.table(usual_header, usual_lines),
        report.table(HEADER, [claim.cells for claim in claims]),
    ]
    write_comparison(out, "PETS2009 S2.L1", lines, gallery, tables)
    print(f"\npage: {out / 'compare.html'}")


def _images(video: str, progress: Progress) -> Iterator[tuple[int, Image]]:
    with open_source(video) as source:
        for frame in source:
            if frame.image is not None:
                yield frame.number, frame.image
            progress.update()


def _tracks_of_chains(
    video: str, truth: BoxTruth, size: tuple[int, int], gallery: Gallery
) -> dict[str, TrackScores]:
    """Track measures of the model with and without feedback; fills the gallery on the way."""
    alone = Model("alone", "stand-alone", size, {"background": {"prior": SHOWN_PRIOR}})
    systems = [Model(name, engine, size) for name, engine in CHAINS]
    rows: dict[str, list[tuple[float, ...]]] = {system.name: [] for system in systems}
    with open_source(video) as source, Progress("tracks", source.n_frames) as progress:
        for frame in source:
            by_itself = alone.step(frame)
            for system in systems:
                found = system.step(frame)
                if frame.image is not None and system.name == "RSMCM":
                    gallery.add(frame.number, frame.image, [(alone, by_itself), (system, found)])
                rows[system.name] += [(frame.number, each.identity, *each.box) for each in found.tracks]
            progress.update()
    return {name: _track_scores(truth, boxes) for name, boxes in rows.items()}


@dataclass(frozen=True)
class Tried:
    """A subtractor, a clean-up and a tracker's parameters, and how good the tracks are."""

    row: Row[Found]
    min_area: int
    parameters: tuple[float, int, int]
    scores: TrackScores

    @property
    def method(self) -> str:
        """Name of the subtractor."""
        return self.row.setting.method

    @property
    def described(self) -> str:
        """The parameters in words."""
        clean_up = _described(self.row.setting, replace(self.row.clean_up, min_area=self.min_area))
        least_overlap, min_hits, max_age = self.parameters
        return f"{clean_up}; overlap {least_overlap}, hits {min_hits}, age {max_age}"


def _tracks_of_usual(video: str, truth: BoxTruth, settings: Sequence[Setting], long: bool) -> list[Tried]:
    """Track measures of subtractors with Kalman filters and assignment behind them."""

    def found(number: int, mask: Image) -> Found:
        every = components(mask)
        return number, every[every[:, 4] >= min(TRACK_AREAS)]

    with Progress("components", len(truth.frames) * len(settings)) as progress:
        rows = list(
            sweep_subtractors(
                lambda: _images(video, progress), truth.frames, found, settings, TRACK_CLEAN_UPS
            )
        )
    if long:
        return _tried(truth, rows, TRACK_AREAS, TRACKER_PARAMETERS)
    first = _tried(truth, rows, [FIRST_AREA], [FIRST_PARAMETERS])
    finalists: list[Row[Found]] = []
    for method in ("MOG2", "KNN"):
        own = [tried for tried in first if tried.method == method]
        for measure in ("idf1", "mota"):
            own.sort(key=lambda tried: float(getattr(tried.scores, measure)), reverse=True)
            finalists += [tried.row for tried in own[:N_FINALISTS] if tried.row not in finalists]
    return _tried(truth, finalists, TRACK_AREAS, TRACKER_PARAMETERS)


def _tried(
    truth: BoxTruth,
    rows: Sequence[Row[Found]],
    areas: Sequence[int],
    parameters: Sequence[tuple[float, int, int]],
) -> list[Tried]:
    combined = list(product(rows, areas, parameters))
    made = []
    with Progress("usual tracks", len(truth.frames) * len(combined)) as progress:
        for row, area, chosen in combined:
            tracker = KalmanHungarian(*chosen)
            tracks: list[tuple[float, ...]] = []
            for number, found in row.values:
                boxes = found[found[:, 4] >= area, :4]
                tracks += [(number, *track) for track in tracker.update(boxes).tolist()]
                progress.update()
            made.append(Tried(row, area, chosen, _track_scores(truth, tracks)))
    return made


def _track_scores(truth: BoxTruth, rows: list[tuple[float, ...]]) -> TrackScores:
    return evaluate_tracks(truth, np.array(rows, np.float64).reshape(-1, 6), truth.frames)


def _sum(row: Row[ErrorClasses]) -> ErrorClasses:
    return sum(row.values, ErrorClasses())


def _described(setting: Setting, clean_up: CleanUp) -> str:
    parts = [setting.parameters] if setting.parameters else []
    parts += ["shadows kept"] if clean_up.keep_shadows and setting.parameters else []
    for name in ("median", "opening", "closing"):
        parts += [f"{name} {getattr(clean_up, name)}"] if getattr(clean_up, name) else []
    return ", ".join([*parts, f"area {clean_up.min_area}"])


def _track_cells(scores: TrackScores | None) -> dict[str, float]:
    if scores is None:
        return {}
    return {"IDF1": scores.idf1, "MOTA": scores.mota, "id switches": scores.switches}


# --- highway ------------------------------------------------------------------------------------------------


def reproduce_highway(out: Path) -> None:
    """Foreground of CDnet's highway against its masks, raw and after a 5x5 median.

    Raises
    ------
    OSError
        if the sequence cannot be found, or the folder cannot be written to.
    """
    folder = data_folder("cdnet-highway")
    truth = read_ground_truth(folder)
    assert isinstance(truth, MaskTruth)
    out.mkdir(parents=True, exist_ok=True)
    with open_source(str(folder / "input")) as source:
        size, rate, n_frames = source.size, source.rate, source.n_frames
    settings = [
        Setting(name, "", partial(ModelSubtractor, engine, size, rate)) for name, engine in CHAINS
    ] + [
        each
        for each in SETTINGS
        if each.parameters in ("history 500, threshold 16", "history 500, threshold 400")
    ]
    lines: list[list[object]] = []
    measured: dict[tuple[str, int], float] = {}
    numbers = set(truth.frames)

    def evaluate(number: int, mask: Image) -> PixelScore:
        one = PixelScore()
        one.add(number, mask, truth.labels(number))
        return one

    with Progress("highway", (n_frames or 1700) * len(settings)) as progress:
        for row in sweep_subtractors(
            lambda: _images(str(folder / "input"), progress), numbers, evaluate, settings, (CleanUp(), MEDIAN)
        ):
            scores = _total(row.values)
            measured[row.setting.method, row.clean_up.median] = scores.f_measure
            clean_up = "5x5 median" if row.clean_up.median else "raw"
            lines.append([row.setting.method, clean_up, scores.precision, scores.recall, scores.f_measure])
    claims = [
        Claim("F, raw", measured["RSMCM", 0], ">=", 0.93),
        Claim("F, after a 5x5 median", measured["RSMCM", 5], ">=", 0.955),
    ]
    header = ("method", "clean-up", "precision", "recall", "F")
    _print_tables(header, lines, claims)
    tables = [report.table(header, lines), report.table(HEADER, [claim.cells for claim in claims])]
    report.write_page(out / "index.html", "CDnet highway", [("", tables)])
    print(f"\npage: {out / 'index.html'}")


# --- together -----------------------------------------------------------------------------------------------


def _size(frames: Sequence[Frame]) -> tuple[int, int]:
    image = frames[0].image
    assert image is not None
    return image.shape[1], image.shape[0]


def _print_tables(header: Sequence[str], lines: Sequence[Sequence[object]], claims: Sequence[Claim]) -> None:
    print(in_columns(header, lines))
    print()
    print(in_columns(HEADER, [claim.cells for claim in claims]))
