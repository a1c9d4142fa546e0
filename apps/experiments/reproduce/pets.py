"""Figs. 8 and 11 of the RSMCM paper on PETS2009 S2.L1: errors of extracted components, and tracks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ....models.core.frame import Frame
from ...background.compare import PRIORS, SHOWN_PRIOR, Gallery, write_comparison
from ...background.methods import CHAINS, Model, ModelSubtractor
from ...evaluation.masks import ErrorClasses, error_classes
from ...evaluation.tracks import TrackScores, evaluate_tracks
from ...io.datasets import data_folder
from ...io.ground_truth import BoxTruth, read_ground_truth
from ...io.sources.open_source import open_source
from ...reports import page
from ...reports.expectations import HEADER, Expectation, in_columns, print_tables
from ...runs.progress import Progress
from ..trials.baselines import (
    CLEAN_UPS,
    SETTINGS,
    CleanUp,
    KalmanHungarian,
    Row,
    Setting,
    components,
    readable_images,
    sweep_subtractors,
)

Image = NDArray[np.uint8]
Found = tuple[int, NDArray[np.float64]]
"""A frame's number and its components' boxes and areas `(n, 5)`."""

NOISE_SEEDS = range(5)
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
    out.mkdir(parents=True, exist_ok=True)
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
                lambda: readable_images(video, progress),
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
    rates = _rates(video, truth, size)
    expectations = _expectations(errors, dual, best_usual.scores, most_accurate.scores)
    expectations += _expectations_of_rates(rates)
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
    print_tables(header, [[line.get(name, "") for name in header] for line in lines], expectations)
    tables = [
        page.table(usual_header, usual_lines),
        page.table(HEADER, [expectation.cells for expectation in expectations]),
    ]
    write_comparison(out, "PETS2009 S2.L1", lines, gallery, tables)
    print(f"\npage: {out / 'compare.html'}")


def _expectations(
    errors: Mapping[str, ErrorClasses], dual: TrackScores, best: TrackScores, most_accurate: TrackScores
) -> list[Expectation]:
    """What is wanted of RSMCM beside the usual trackers with the best IDF1 and the best MOTA."""
    own, usual = errors["RSMCM"].errors, min(errors["MOG2"].errors, errors["KNN"].errors)
    feed_forward = max(errors["feed-forward"].errors, 1)
    return [
        Expectation("missed + ghosts, RSMCM over the best of MOG2 and KNN", own / usual, "<=", 0.7),
        Expectation("missed + ghosts, RSMCM over feed-forward", own / feed_forward, "<=", 0.8),
        Expectation("IDF1, RSMCM over the best usual tracker", dual.idf1 / best.idf1, ">=", 1.25),
        Expectation("id switches, over the same", dual.switches / max(best.switches, 1), "<=", 0.5),
        Expectation(
            "MOTA, RSMCM over the usual tracker with the best", dual.mota / most_accurate.mota, ">=", 1.0
        ),
    ]


def _rates(video: str, truth: BoxTruth, size: tuple[int, int]) -> dict[int, list[TrackScores]]:
    """Track measures in every second frame, by seeds of noise, of a model that sees all frames or those."""
    judged = range(1, max(truth.frames) + 1, 2)
    found: dict[int, list[TrackScores]] = {1: [], 2: []}
    with Progress("10 and 5 frames a second", len(NOISE_SEEDS) * len(found), unit="runs") as progress:
        for step, scores in found.items():
            for seed in NOISE_SEEDS:
                system, rows = Model("RSMCM", "recursive-bp", size), []
                with open_source(video, step=step) as source:
                    for frame in source:
                        tracks = system.step(_noisy(frame, seed)).tracks
                        rows += [(frame.number, each.identity, *each.box) for each in tracks]
                table = np.array(rows, np.float64).reshape(-1, 6)
                scores.append(evaluate_tracks(table, truth, judged))
                progress.update()
    return found


def _noisy(frame: Frame, seed: int) -> Frame:
    """The frame with one grey level more or less in one of a thousand pixels."""
    if frame.image is None:
        return frame
    random = np.random.default_rng([seed, frame.number])
    image = frame.image.reshape(-1, frame.image.shape[-1] if frame.image.ndim == 3 else 1).astype(np.int16)
    changed = random.choice(len(image), len(image) // 1000, replace=False)
    image[changed] += random.choice(np.array([-1, 1], np.int16), len(changed))[:, None]
    return replace(frame, image=image.clip(0, 255).astype(np.uint8).reshape(frame.image.shape))


def _expectations_of_rates(rates: Mapping[int, Sequence[TrackScores]]) -> list[Expectation]:
    """What is wanted of half the frames: the same IDF1 but for what noise changes."""
    whole, half = (np.array([each.idf1 for each in rates[step]]) for step in (1, 2))
    spread = float(max(whole.std(ddof=1), half.std(ddof=1)))
    seeds = f"{len(whole)} seeds of noise"
    return [
        Expectation(f"IDF1 at 10 frames a second, {seeds}", float(whole.mean())),
        Expectation("the same at 5 frames a second", float(half.mean())),
        Expectation("standard deviation over seeds, the larger of both", spread),
        Expectation(
            "IDF1 lost at 5 frames a second, in these", float(whole.mean() - half.mean()) / spread, "<=", 1.0
        ),
    ]


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
                lambda: readable_images(video, progress), truth.frames, found, settings, TRACK_CLEAN_UPS
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
    return evaluate_tracks(np.array(rows, np.float64).reshape(-1, 6), truth)


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
