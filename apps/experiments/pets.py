"""Figs. 8 and 11 of the RSMCM paper on PETS2009 S2.L1: errors of extracted components, and tracks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..evaluation.masks import ErrorClasses, error_classes, ratio
from ..evaluation.tracks import TrackScores, evaluate_tracks
from ..io.ground_truth import BoxTruth
from ..io.sources.open_source import open_source
from ..runs.progress import Progress
from .baselines import (
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
from .compare import CHAINS, PRIORS, SHOWN_PRIOR, Gallery, Model, ModelSubtractor, errors_plot
from .datasets import data_folder
from .expectations import Expectation, over_seeds
from .experiment import Findings
from .record import Table
from .track_trials import (
    MEASURES,
    NOISE_SEEDS,
    WHOLE,
    AnnotatedFilm,
    BySeed,
    Tracks,
    Trial,
    cells,
    detector_expectations,
    detector_trials,
    mean,
    model_tracks,
    pixel_trials,
    run_trials,
    score_trials,
    usual_tracks,
)

Image = NDArray[np.uint8]
Found = tuple[int, NDArray[np.float64]]
"""A frame's number and its components' boxes and areas `(n, 5)`."""

SEEDS = "seeds of noise"
HALF = "RSMCM at half the rate, judged in its frames"
BEST_MOTA = "MOG2 or KNN, best MOTA"
ERRORS_CAPTION = "Errors in every tenth frame, with each method's best clean-up."
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


def pets(*, long: bool) -> Findings:
    """Figs. 8 and 11 on PETS2009 S2.L1: errors of extracted components, and tracks.

    Tracks are found without and with the boxes of a detector, also on TUD-Campus, where people are there from
    the first frame, as far as these files are there.

    Parameters
    ----------
    long
        try all settings of MOG2 and KNN and all clean-ups instead of the middle ones.

    Raises
    ------
    OSError
        if the sequence cannot be found or fetched.
    """
    folder = data_folder("pets2009-s2l1")
    film = AnnotatedFilm.read("PETS2009 S2.L1", folder / "vtest.avi", folder, folder / "det.txt")
    with open_source(film.source) as source:
        size, rate, n_frames = source.size, source.rate, source.n_frames or 795
    settings = [each for each in SETTINGS if long or each.parameters in MIDDLE_SETTINGS]
    ranked = _errors(film, settings, long, size, rate, n_frames)
    gallery = _gallery(film, size)

    peers = best_usual(_tracks_of_usual(film, settings, long))
    trials = [*_without_detector(film, peers), *detector_trials(film)]
    tracks = run_trials(film.name, trials)
    scored = score_trials(trials, tracks, film.truth)
    crowd_trials, crowd = _crowd()

    errors = {name: _sum(rows[0]) for name, rows in ranked.items()}
    expectations = [
        *_expectations_of_errors(errors),
        *over_seeds(_expectations_of_tracks, scored),
        *over_seeds(_expectations_of_rates, _idf1_of_rates(tracks, film.truth)),
        *over_seeds(partial(detector_expectations, film.name, (0.87, 0.87), 15), scored),
    ]
    if crowd:
        expectations += over_seeds(_expectations_of_crowd, crowd)
    lines = [
        {
            "method": name,
            "clean-up": _described(ranked[name][0].setting, ranked[name][0].clean_up),
            "missed pedestrians": found.missed_pedestrians,
            "missed vehicles": found.missed_vehicles,
            "ghosts": found.ghosts,
            "total": found.errors,
            **{title: mean(scored[name], of) for title, of in MEASURES.items() if name in scored},
        }
        for name, found in errors.items()
    ]
    header = list(dict.fromkeys(name for line in lines for name in line))
    track_header = ("film", "method", "setting", *MEASURES)
    track_lines = [
        (where, each.name, each.described, *cells(found[each.name]))
        for where, tried, found in ((film.name, trials, scored), ("TUD-Campus", crowd_trials, crowd))
        for each in tried
    ]
    tables = [
        Table(track_header, track_lines, f"Mean and standard deviation over {len(NOISE_SEEDS)} {SEEDS}."),
        Table(header, [[line.get(name, "") for name in header] for line in lines], ERRORS_CAPTION),
    ]
    return Findings(film.name, tables, expectations, [errors_plot(lines), gallery.picture()])


def _errors(
    film: AnnotatedFilm,
    settings: Sequence[Setting],
    long: bool,
    size: tuple[int, int],
    rate: float,
    n_frames: int,
) -> dict[str, list[Row[ErrorClasses]]]:
    """What is wrong with the components of each method, the best clean-up first."""
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
    with Progress("errors", n_frames * len(everything)) as progress:
        rows = list(
            sweep_subtractors(
                lambda: readable_images(film.source, progress),
                range(FIRST_COUNTED, n_frames + 1, 10),
                lambda number, mask: error_classes(mask, film.truth.at(number)),
                everything,
                clean_ups,
            )
        )
    ranked: dict[str, list[Row[ErrorClasses]]] = {each.method: [] for each in everything}
    for row in sorted(rows, key=lambda row: _sum(row).errors):
        ranked[row.setting.method].append(row)
    return ranked


def _without_detector(film: AnnotatedFilm, peers: Mapping[str, "Tried"]) -> list[Trial]:
    """The model, also at half the frame rate, and the usual pipelines that were found best."""
    trials = pixel_trials(film)
    trials.append(Trial(HALF, "", partial(model_tracks, film, "recursive-bp", 2, None), step=2))
    for name, tried in peers.items():
        clean_up = replace(tried.row.clean_up, min_area=tried.min_area)
        tracks = partial(usual_tracks, film, tried.row.setting, clean_up, tried.parameters)
        trials.append(Trial(name, tried.described, tracks))
    return trials


def _crowd() -> tuple[list[Trial], dict[str, list[TrackScores]]]:
    """What is tried on TUD-Campus, and its scores; nothing where it is not there."""
    try:
        folder = data_folder("tud-campus")
        film = AnnotatedFilm.read("TUD-Campus", folder / "img1", folder, folder / "det" / "det.txt")
    except FileNotFoundError:
        return [], {}
    trials = [*pixel_trials(film), *detector_trials(film)]
    return trials, score_trials(trials, run_trials(film.name, trials), film.truth)


def _expectations_of_errors(errors: Mapping[str, ErrorClasses]) -> list[Expectation]:
    """What is wanted of RSMCM's components beside those of the others."""
    own, usual = errors["RSMCM"].errors, max(min(errors["MOG2"].errors, errors["KNN"].errors), 1)
    feed_forward = max(errors["feed-forward"].errors, 1)
    return [
        Expectation("missed + ghosts of RSMCM in every tenth frame", own),
        Expectation("missed + ghosts, RSMCM over the best of MOG2 and KNN", own / usual, "<=", 0.7),
        Expectation("missed + ghosts, RSMCM over feed-forward", own / feed_forward, "<=", 0.8),
    ]


def _expectations_of_crowd(found: BySeed) -> list[Expectation]:
    """What is wanted on TUD-Campus."""
    name = "TUD-Campus without a detector, whole film"
    return [
        *detector_expectations("TUD-Campus", (0.70, 0.62), None, found),
        Expectation(f"{name}: IDF1", mean(found[WHOLE], "idf1"), ">=", 0.5),
        Expectation(f"{name}: MOTA", mean(found[WHOLE], "mota"), ">=", 0.3),
    ]


def _expectations_of_tracks(found: BySeed) -> list[Expectation]:
    """What is wanted of RSMCM beside the usual trackers with the best IDF1 and the best MOTA."""
    dual = found["RSMCM"]
    peers = [found[name] for name in ("MOG2", "KNN", BEST_MOTA) if name in found]
    best = max(peers, key=lambda peer: mean(peer, "idf1"))
    idf1, mota, switches = (mean(dual, name) for name in ("idf1", "mota", "switches"))
    best_mota = max(mean(peer, "mota") for peer in peers)
    times = ratio(idf1, mean(best, "idf1"))
    return [
        Expectation("IDF1", idf1, ">=", 0.83),
        Expectation("MOTA", mota, ">=", 0.74),
        Expectation("id switches", switches),
        Expectation("IDF1, RSMCM over the best usual tracker", times, ">=", 1.25),
        Expectation("id switches, over the same", switches / max(mean(best, "switches"), 1), "<=", 0.5),
        Expectation("MOTA, RSMCM over the usual tracker with the best", ratio(mota, best_mota), ">=", 1.0),
    ]


def _idf1_of_rates(tracks: Mapping[str, Sequence[Tracks]], truth: BoxTruth) -> dict[str, list[float]]:
    """IDF1 of each seed with all frames and with half of them, both judged in these."""
    judged = range(1, max(truth.frames) + 1, 2)
    return {
        name: [evaluate_tracks(table, truth, judged).idf1 for table in tracks[name]]
        for name in ("RSMCM", HALF)
    }


def _expectations_of_rates(found: Mapping[str, Sequence[float]]) -> list[Expectation]:
    """What is wanted of half the frames: the same IDF1 but for what noise changes."""
    whole, half = np.array(found["RSMCM"]), np.array(found[HALF])
    spread = float(max(whole.std(ddof=1), half.std(ddof=1)))
    return [
        Expectation("IDF1 at 10 frames a second, in every second", float(whole.mean())),
        Expectation("the same at 5 frames a second", float(half.mean())),
        Expectation("standard deviation over seeds, the larger of both", spread),
        Expectation(
            "IDF1 lost at 5 frames a second, in these", ratio(whole.mean() - half.mean(), spread), "<=", 1.0
        ),
    ]


def _gallery(film: AnnotatedFilm, size: tuple[int, int]) -> Gallery:
    """Moments of the film as it is, of the background by itself and of the model."""
    gallery = Gallery()
    alone = Model("alone", "stand-alone", size, {"background": {"prior": SHOWN_PRIOR}})
    dual = Model("RSMCM", "recursive-bp", size)
    with open_source(film.source) as source, Progress("pictures", source.n_frames) as progress:
        for frame in source:
            found = [(alone, alone.step(frame)), (dual, dual.step(frame))]
            if frame.image is not None:
                gallery.add(frame.number, frame.image, found)
            progress.update()
    return gallery


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
        setting = f"{self.method}, {clean_up}"
        return f"{setting}; overlap {least_overlap}, hits {min_hits}, age {max_age}"


def best_usual(tried: Sequence[Tried]) -> dict[str, Tried]:
    """By what they are called in tables: those with the best IDF1 of MOG2 and KNN, and with the best MOTA."""
    best = {
        name: max((each for each in tried if each.method == name), key=lambda each: each.scores.idf1)
        for name in ("MOG2", "KNN")
    }
    most_accurate = max(tried, key=lambda each: each.scores.mota)
    return best if most_accurate in best.values() else {**best, BEST_MOTA: most_accurate}


def _tracks_of_usual(film: AnnotatedFilm, settings: Sequence[Setting], long: bool) -> list[Tried]:
    """Track measures of subtractors with Kalman filters and assignment behind them, on the film as it is."""
    truth = film.truth

    def found(number: int, mask: Image) -> Found:
        every = components(mask)
        return number, every[every[:, 4] >= min(TRACK_AREAS)]

    with Progress("components", len(truth.frames) * len(settings)) as progress:
        rows = list(
            sweep_subtractors(
                lambda: readable_images(film.source, progress), truth.frames, found, settings, TRACK_CLEAN_UPS
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
