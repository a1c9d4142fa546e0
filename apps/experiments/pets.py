"""Figs. 8 and 11 of the RSMCM paper on PETS2009 S2.L1: errors of extracted components, and tracks.

Tracks are chaotic: one grey level in one of a thousand pixels moves their scores by some hundredths. So each
method is tried over seeds of noise, and a score is a mean, with its standard deviation.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..background.application import build_model
from ..background.job import WHOLE_FILM, BackgroundJob, Engine
from ..background.whole_film import read_whole
from ..evaluation.masks import ErrorClasses, error_classes, ratio
from ..evaluation.tracks import TrackScores, evaluate_tracks
from ..io.detections import Detections, read_detections, with_boxes
from ..io.ground_truth import BoxTruth, read_ground_truth
from ..io.sources.open_source import open_source
from ..runs.interruption import Interruption
from ..runs.parallel import in_parallel
from ..runs.progress import Progress
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
from .compare import CHAINS, PRIORS, SHOWN_PRIOR, TRACKS, Gallery, Model, ModelSubtractor, errors_plot
from .datasets import data_folder
from .experiment import Findings, by_seed, noisy
from .record import Expectation, Table, over_seeds

Image = NDArray[np.uint8]
Tracks = NDArray[np.float64]  # `(n, 6)`: frame, identity, x, y, width, height (px)
BySeed = Mapping[str, Sequence[TrackScores]]  # scores of methods by name, one for each seed
Parameters = tuple[float, int, int]
"""Of `KalmanHungarian`: least overlap, hits from which a track counts, frames without a find after which it
ends."""

NOISE_SEEDS = range(5)

# --- films, and methods that are tried on them --------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class AnnotatedFilm:
    """Film with ground truth: name, source, true boxes, and detections if there are any."""

    name: str
    source: str
    truth: BoxTruth
    detections: Detections | None = None

    @classmethod
    def read(cls, name: str, source: Path, truth: Path, detections: Path) -> Self:
        """Read true boxes, and detections if their file is there.

        Raises
        ------
        ValueError, OSError
            if a file is damaged, or that of the true boxes is not there.
        """
        boxes = read_ground_truth(truth)
        assert isinstance(boxes, BoxTruth)
        with open_source(str(source)) as film:
            pictures = film.pictures
        found = read_detections(detections, pictures=pictures) if detections.exists() else None
        return cls(name, str(source), boxes, found)

    def frames(self, seed: int, step: int = 1, every: int | None = None) -> Iterator[Frame]:
        """Yield frames with noise; with the detector's boxes on every `every`-th, if that is given."""
        with open_source(self.source, step=step) as source:
            yield from self.prepare(source, seed, every)

    def prepare(self, frames: Iterable[Frame], seed: int, every: int | None) -> Iterator[Frame]:
        """Add noise and boxes to frames of an open source."""
        shaken = (noisy(frame, seed) for frame in frames)
        if every is None:
            return shaken
        assert self.detections is not None
        return with_boxes(shaken, self.detections, every)


@dataclass(frozen=True)
class Trial:
    """Method to be tried."""

    # name, described: the method, and how it is set, for tables
    name: str
    described: str
    tracks: Callable[[int], Tracks]  # makes tracks of a seed of noise; can be sent to another process
    seeds: Sequence[int] = NOISE_SEEDS  # one is enough for methods that see no pictures
    step: int = 1  # only every `step`-th frame is judged, where it sees no others


def run_trials(label: str, trials: Sequence[Trial]) -> dict[str, list[Tracks]]:
    """Return the tracks of all trials by name, one table a seed; made in several processes."""
    work = [(trial.tracks, (seed,)) for trial in trials for seed in trial.seeds]
    made = iter(in_parallel(label, work))
    return {trial.name: [next(made) for _ in trial.seeds] for trial in trials}


def score_trials(
    trials: Sequence[Trial], tracks: Mapping[str, Sequence[Tracks]], truth: BoxTruth
) -> dict[str, list[TrackScores]]:
    """Return scores of all trials by name, one for each seed."""
    found = {}
    for trial in trials:
        judged = [number for number in truth.frames if (number - 1) % trial.step == 0]
        found[trial.name] = [evaluate_tracks(table, truth, judged) for table in tracks[trial.name]]
    return found


def mean(scores: Sequence[TrackScores], measure: str) -> float:
    """Return the mean of an attribute of `TrackScores` over seeds."""
    return float(np.mean([getattr(each, measure) for each in scores]))


def cells(scores: Sequence[TrackScores]) -> list[str]:
    """Return a table's cells of `TRACKS`: mean and, of several seeds, standard deviation."""
    found = []
    for measure in TRACKS.values():
        digits, values = 1 if measure == "switches" else 3, [getattr(each, measure) for each in scores]
        deviation = f" ± {np.std(values, ddof=1):.{digits}f}" if len(values) > 1 else ""
        found.append(f"{np.mean(values):.{digits}f}{deviation}")
    return found


def model_tracks(film: AnnotatedFilm, engine: Engine, step: int, every: int | None, seed: int) -> Tracks:
    """Track with a multi-chain model on every `step`-th frame, perhaps with the detector's boxes."""
    system: Model | None = None
    rows: list[tuple[float, ...]] = []
    for frame in film.frames(seed, step, every):
        if system is None:
            assert frame.image is not None
            system = Model("", engine, (frame.image.shape[1], frame.image.shape[0]))
        rows += [(frame.number, each.identity, *each.box) for each in system.step(frame).tracks]
    return _table(rows)


def whole_film_tracks(film: AnnotatedFilm, every: int | None, seed: int) -> Tracks:
    """Track with the model of whole films, perhaps with the detector's boxes."""
    job = BackgroundJob(film.source, out=Path(), engine=WHOLE_FILM)  # nothing is written
    model, known = build_model(job.engine), partial(film.prepare, seed=seed, every=every)
    with open_source(film.source) as source:
        _, objects = read_whole(job, source, model, known, Interruption())
        count = source.n_frames
    assert count is not None
    return _table(
        [(index + 1, track.identity, *track.box) for index in range(count) for track in objects.at(index)]
    )


def usual_tracks(
    film: AnnotatedFilm, setting: Setting, clean_up: CleanUp, parameters: Parameters, seed: int
) -> Tracks:
    """Track with a subtractor, a clean-up, Kalman filters and assignment."""
    subtractor, tracker = setting.make(), KalmanHungarian(*parameters)
    rows: list[tuple[float, ...]] = []
    for frame in film.frames(seed):
        if frame.image is not None:
            boxes = components(clean_up.apply(subtractor.apply(frame.image)))[:, :4]
            rows += [(frame.number, *track) for track in tracker.update(boxes).tolist()]
    return _table(rows)


def _table(rows: Sequence[tuple[float, ...]]) -> Tracks:
    return np.array(rows, np.float64).reshape(-1, 6)


# --- association of detections without pictures -------------------------------------------------------------

SCORE_QUANTILES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
ASSOCIATIONS: Sequence[Parameters] = tuple(product((0.1, 0.3), (1, 3, 5), (10, 20)))


def associated(
    film: AnnotatedFilm, every: int, quantile: float, parameters: Parameters, seed: int = 0
) -> Tracks:
    """Track the detector's boxes on every `every`-th frame with Kalman filters and assignment.

    In between, tracks are where their filters predict them. `quantile` is the share of the boxes that is left
    out, those with the lowest scores. The seed is not used: nothing is seen of the pictures.
    """
    found = film.detections
    assert found is not None
    least = -np.inf if found.confidence is None else np.quantile(found.confidence, quantile)
    tracker = KalmanHungarian(*parameters)
    rows: list[tuple[float, ...]] = []
    for index, number in enumerate(range(1, film.truth.frames[-1] + 1)):
        boxes = found.at(number) if index % every == 0 else None
        given = None
        if boxes is not None:
            kept = boxes.xyxy if boxes.confidence is None else boxes.xyxy[boxes.confidence >= least]
            given = np.column_stack([kept[:, :2], kept[:, 2:] - kept[:, :2]])
        rows += [(number, *track) for track in tracker.update(given).tolist()]
    return _table(rows)


def best_associations(film: AnnotatedFilm, every: int) -> dict[str, tuple[str, partial[Tracks]]]:
    """Return the best plain association in IDF1 and in MOTA on this film: in words, and its tracks."""
    combined = list(product(SCORE_QUANTILES, ASSOCIATIONS))
    work = [(_association_scores, (film, every, *each)) for each in combined]
    scores: list[TrackScores] = in_parallel(f"{film.name}, association", work)
    best = {}
    for title in ("IDF1", "MOTA"):
        values = [getattr(each, TRACKS[title]) for each in scores]
        quantile, parameters = combined[int(np.argmax(values))]
        described = f"lowest {quantile:.0%} left out; {_in_words(parameters)}"
        best[title] = described, partial(associated, film, every, quantile, parameters)
    return best


def _association_scores(
    film: AnnotatedFilm, every: int, quantile: float, parameters: Parameters
) -> TrackScores:
    return evaluate_tracks(associated(film, every, quantile, parameters), film.truth)


def _in_words(parameters: Parameters) -> str:
    overlap, hits, age = parameters
    return f"overlap {overlap}, hits {hits}, age {age}"


# --- subtractors, clean-ups and trackers, of which the best are tried ---------------------------------------

MIDDLE_SETTINGS = {
    f"history {history}, threshold {threshold}" for history in (200, 500) for threshold in (16, 32, 400, 800)
}
# Which clean-up serves tracks best is not the one with the fewest errors, so they are chosen by themselves.
TRACK_CLEAN_UPS = tuple(
    CleanUp(keep_shadows, median, opening, closing)
    for keep_shadows, (median, opening, closing) in product((False, True), ((5, 0, 0), (0, 3, 9), (0, 3, 15)))
)
TRACK_AREAS = (100, 200, 400)
TRACKER_PARAMETERS: Sequence[Parameters] = tuple(product((0.1, 0.3), (3, 5), (10, 20)))
FIRST_AREA, FIRST_PARAMETERS = 200, (0.1, 5, 20)  # what settings and clean-ups are first compared with
N_FINALISTS = 2  # so many of each method, by IDF1 and by MOTA, are tried with all areas and parameters
Component = tuple[int, NDArray[np.float64]]  # a frame's number and its components' boxes and areas `(n, 5)`


@dataclass(frozen=True)
class ScoredBaseline:
    """Subtractor, clean-up and a tracker's parameters, and the scores of their tracks."""

    row: Row[Component]
    clean_up: CleanUp
    parameters: Parameters
    scores: TrackScores

    @property
    def method(self) -> str:
        """Name of the subtractor."""
        return self.row.setting.method

    @property
    def described(self) -> str:
        """The parameters in words."""
        return f"{self.method}, {_described(self.row.setting, self.clean_up)}; {_in_words(self.parameters)}"


def best_usual(tried: Sequence[ScoredBaseline]) -> dict[str, ScoredBaseline]:
    """Return by name those with the best IDF1 of MOG2 and KNN, and with the best MOTA."""
    best = {
        name: max((each for each in tried if each.method == name), key=lambda each: each.scores.idf1)
        for name in ("MOG2", "KNN")
    }
    most_accurate = max(tried, key=lambda each: each.scores.mota)
    return best if most_accurate in best.values() else {**best, BEST_MOTA: most_accurate}


def _tracks_of_usual(film: AnnotatedFilm, settings: Sequence[Setting]) -> list[ScoredBaseline]:
    """Track measures of subtractors with Kalman filters and assignment behind them, on the film as it is."""

    def detect(number: int, mask: Image) -> Component:
        every = components(mask)
        return number, every[every[:, 4] >= min(TRACK_AREAS)]

    frames = film.truth.frames
    with Progress("components", len(frames) * len(settings)) as progress:
        images = partial(_readable, film.source, progress)
        rows = list(sweep_subtractors(images, frames, detect, settings, TRACK_CLEAN_UPS))
    first = _tried(film.truth, rows, [FIRST_AREA], [FIRST_PARAMETERS])
    finalists: list[Row[Component]] = []
    for method in ("MOG2", "KNN"):
        own = [tried for tried in first if tried.method == method]
        for measure in ("idf1", "mota"):
            own.sort(key=lambda tried: float(getattr(tried.scores, measure)), reverse=True)
            finalists += [tried.row for tried in own[:N_FINALISTS] if tried.row not in finalists]
    return _tried(film.truth, finalists, TRACK_AREAS, TRACKER_PARAMETERS)


def _tried(
    truth: BoxTruth, rows: Sequence[Row[Component]], areas: Sequence[int], parameters: Sequence[Parameters]
) -> list[ScoredBaseline]:
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
            scores = evaluate_tracks(_table(tracks), truth)
            made.append(ScoredBaseline(row, replace(row.clean_up, min_area=area), chosen, scores))
    return made


def _readable(video: str, progress: Progress) -> Iterator[tuple[int, Image]]:
    """Yield number and picture of every frame that can be read, and count all of them as done."""
    with open_source(video) as source:
        for frame in source:
            if frame.image is not None:
                yield frame.number, frame.image
            progress.update()


def _described(setting: Setting, clean_up: CleanUp) -> str:
    parts = [setting.parameters] if setting.parameters else []
    parts += ["shadows kept"] if clean_up.keep_shadows and setting.parameters else []
    for name in ("median", "opening", "closing"):
        parts += [f"{name} {getattr(clean_up, name)}"] if getattr(clean_up, name) else []
    return ", ".join([*parts, f"area {clean_up.min_area}"])


# --- what is compared ---------------------------------------------------------------------------------------

FIRST_COUNTED = 40  # errors are counted in every tenth frame after 30
FIFTH = 5
HALF = "RSMCM at half the rate, judged in its frames"
BEST_MOTA = "MOG2 or KNN, best MOTA"
WHOLE, WHOLE_DETECTED = "RSMCM, whole film", "RSMCM, whole film, detector"
DETECTED, CUT, RARE = "RSMCM, detector", "feed-forward, detector", "RSMCM, detector on every fifth frame"
PLAIN, RARE_PLAIN = "association", "association, every fifth frame"


def pets() -> Findings:
    """Run Figs. 8 and 11 on PETS2009 S2.L1: errors of extracted components, and tracks.

    Tracks are found without and with the boxes of a detector, also on TUD-Campus, where people are there from
    the first frame, as far as these files are there.

    Raises
    ------
    OSError
        if the sequence cannot be found or fetched.
    """
    folder = data_folder("pets2009-s2l1")
    film = AnnotatedFilm.read("PETS2009 S2.L1", folder / "vtest.avi", folder, folder / "det.txt")
    settings = [each for each in SETTINGS if each.parameters in MIDDLE_SETTINGS]
    ranked = _errors(film, settings)
    gallery = _gallery(film)

    half = Trial(HALF, "", partial(model_tracks, film, "recursive-bp", 2, None), step=2)
    peers = [
        Trial(
            name,
            each.described,
            partial(usual_tracks, film, each.row.setting, each.clean_up, each.parameters),
        )
        for name, each in best_usual(_tracks_of_usual(film, settings)).items()
    ]
    trials = [*pixel_trials(film), half, *peers, *detector_trials(film)]
    tracks = run_trials(film.name, trials)
    scored = score_trials(trials, tracks, film.truth)
    crowd_trials, crowd = _crowd()

    errors = {name: _sum(rows[0]) for name, rows in ranked.items()}
    expectations = [
        *over_seeds(_expectations_of_errors, _errors_by_seed(film, ranked)),
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
            **{title: mean(scored[name], of) for title, of in TRACKS.items() if name in scored},
        }
        for name, found in errors.items()
    ]
    header = list(dict.fromkeys(name for line in lines for name in line))
    track_lines = [
        (where, each.name, each.described, *cells(found[each.name]))
        for where, tried, found in ((film.name, trials, scored), ("TUD-Campus", crowd_trials, crowd))
        for each in tried
    ]
    caption = f"Mean and standard deviation over {len(NOISE_SEEDS)} seeds of noise."
    in_every_tenth = "Errors in every tenth frame, with each method's best clean-up."
    tables = [
        Table(("film", "method", "setting", *TRACKS), track_lines, caption),
        Table(header, [[line.get(name, "") for name in header] for line in lines], in_every_tenth),
    ]
    return Findings(film.name, tables, expectations, [errors_plot(lines), gallery.picture()])


def _errors(film: AnnotatedFilm, settings: Sequence[Setting]) -> dict[str, list[Row[ErrorClasses]]]:
    """What is wrong with the components of each method, the best clean-up first."""
    with open_source(film.source) as source:
        size, rate, n_frames = source.size, source.rate, source.n_frames or 795
    priors: list[tuple[str, Engine, dict[str, dict[str, float]]]] = [
        (f"stand-alone, P(B) = {prior}", "stand-alone", {"background": {"prior": prior}}) for prior in PRIORS
    ]
    everything = [
        *(
            Setting(name, "", partial(ModelSubtractor, engine, size, rate, parameters))
            for name, engine, parameters in [*priors, *((*chain, {}) for chain in CHAINS)]
        ),
        *settings,
    ]
    with Progress("errors", n_frames * len(everything)) as progress:
        rows = sweep_subtractors(
            partial(_readable, film.source, progress),
            range(FIRST_COUNTED, n_frames + 1, 10),
            lambda number, mask: error_classes(mask, film.truth.at(number)),
            everything,
            CLEAN_UPS,
        )
        ranked: dict[str, list[Row[ErrorClasses]]] = {each.method: [] for each in everything}
        for row in sorted(rows, key=lambda row: _sum(row).errors):
            ranked[row.setting.method].append(row)
    return ranked


def _errors_by_seed(
    film: AnnotatedFilm, ranked: Mapping[str, Sequence[Row[ErrorClasses]]]
) -> dict[str, list[ErrorClasses]]:
    """Errors with noise of the methods that are judged, each with the clean-up that is best without it."""
    best = [ranked[name][0] for name in ("RSMCM", "feed-forward", "MOG2", "KNN")]
    measured = by_seed(
        "errors with noise",
        partial(_count_errors, film),
        [(row.setting, row.clean_up) for row in best],
        NOISE_SEEDS,
    )
    return {name: errors for of_one in measured.values() for name, errors in of_one.items()}


def _count_errors(film: AnnotatedFilm, method: tuple[Setting, CleanUp], seed: int) -> dict[str, ErrorClasses]:
    setting, clean_up = method
    (row,) = sweep_subtractors(
        lambda: ((each.number, each.image) for each in film.frames(seed) if each.image is not None),
        range(FIRST_COUNTED, film.truth.frames[-1] + 1, 10),
        lambda number, mask: error_classes(mask, film.truth.at(number)),
        [setting],
        [clean_up],
    )
    return {setting.method: _sum(row)}


def _sum(row: Row[ErrorClasses]) -> ErrorClasses:
    return sum(row.values, ErrorClasses())


def _gallery(film: AnnotatedFilm) -> Gallery:
    """Moments of the film as it is, of the background by itself and of the model."""
    gallery = Gallery()
    with open_source(film.source) as source, Progress("pictures", source.n_frames) as progress:
        alone = Model("alone", "stand-alone", source.size, {"background": {"prior": SHOWN_PRIOR}})
        both = (alone, Model("RSMCM", "recursive-bp", source.size))
        for frame in source:
            found = [(model, model.step(frame)) for model in both]
            if frame.image is not None:
                gallery.add(frame.number, frame.image, found)
            progress.update()
    return gallery


def _crowd() -> tuple[list[Trial], dict[str, list[TrackScores]]]:
    """What is tried on TUD-Campus, and its scores; nothing where it is not there."""
    try:
        folder = data_folder("tud-campus")
        film = AnnotatedFilm.read("TUD-Campus", folder / "img1", folder, folder / "det" / "det.txt")
    except FileNotFoundError:
        return [], {}
    trials = [*pixel_trials(film), *detector_trials(film)]
    return trials, score_trials(trials, run_trials(film.name, trials), film.truth)


def pixel_trials(film: AnnotatedFilm) -> list[Trial]:
    """Return the trials without a detector: with and without feedback, and of the whole film."""
    trials = [Trial(name, "", partial(model_tracks, film, engine, 1, None)) for name, engine in CHAINS]
    return [*trials, Trial(WHOLE, "", partial(whole_film_tracks, film, None))]


def detector_trials(film: AnnotatedFilm) -> list[Trial]:
    """Return the trials with a detector, on every frame and every fifth, and of plain association.

    Nothing where there are no detections.
    """
    if film.detections is None:
        return []
    trials = [
        Trial(DETECTED, "", partial(model_tracks, film, "recursive-bp", 1, 1)),
        Trial(CUT, "", partial(model_tracks, film, "feed-forward", 1, 1)),
        Trial(RARE, "", partial(model_tracks, film, "recursive-bp", 1, FIFTH)),
        Trial(WHOLE_DETECTED, "", partial(whole_film_tracks, film, 1)),
    ]
    for name, every in ((PLAIN, 1), (RARE_PLAIN, FIFTH)):
        for title, (described, run) in best_associations(film, every).items():
            trials.append(Trial(f"{name}, best {title}", described, run, (0,)))
    return trials


def _expectations_of_errors(errors: Mapping[str, Sequence[ErrorClasses]]) -> list[Expectation]:
    """What is wanted of RSMCM's components beside those of the others."""
    mean = {name: float(np.mean([each.errors for each in of_seeds])) for name, of_seeds in errors.items()}
    usual, feed_forward = max(min(mean["MOG2"], mean["KNN"]), 1), max(mean["feed-forward"], 1)
    return [
        Expectation("missed + ghosts of RSMCM in every tenth frame", mean["RSMCM"]),
        Expectation("missed + ghosts, RSMCM over the best of MOG2 and KNN", mean["RSMCM"] / usual, "<=", 0.7),
        Expectation("missed + ghosts, RSMCM over feed-forward", mean["RSMCM"] / feed_forward, "<=", 0.8),
    ]


def _expectations_of_tracks(scores: BySeed) -> list[Expectation]:
    """What is wanted of RSMCM beside the usual trackers with the best IDF1 and the best MOTA."""
    peers = [scores[name] for name in ("MOG2", "KNN", BEST_MOTA) if name in scores]
    best = max(peers, key=lambda peer: mean(peer, "idf1"))
    idf1, mota, switches = (mean(scores["RSMCM"], name) for name in ("idf1", "mota", "switches"))
    times = ratio(idf1, mean(best, "idf1"))
    over_best = ratio(mota, max(mean(peer, "mota") for peer in peers))
    return [
        Expectation("IDF1", idf1, ">=", 0.83),
        Expectation("MOTA", mota, ">=", 0.74),
        Expectation("id switches", switches),
        Expectation("IDF1, RSMCM over the best usual tracker", times, ">=", 1.25),
        Expectation("id switches, over the same", switches / max(mean(best, "switches"), 1), "<=", 0.5),
        Expectation("MOTA, RSMCM over the usual tracker with the best", over_best, ">=", 1.0),
    ]


def _idf1_of_rates(tracks: Mapping[str, Sequence[Tracks]], truth: BoxTruth) -> dict[str, list[float]]:
    """IDF1 of each seed with all frames and with half of them, both judged in these."""
    judged = range(1, max(truth.frames) + 1, 2)
    return {
        name: [evaluate_tracks(table, truth, judged).idf1 for table in tracks[name]]
        for name in ("RSMCM", HALF)
    }


def _expectations_of_rates(idf1_of: Mapping[str, Sequence[float]]) -> list[Expectation]:
    """What is wanted of half the frames: the same IDF1 but for what noise changes."""
    whole, half = np.array(idf1_of["RSMCM"]), np.array(idf1_of[HALF])
    deviation = float(max(whole.std(ddof=1), half.std(ddof=1)))
    lost = ratio(whole.mean() - half.mean(), deviation)
    return [
        Expectation("IDF1 at 10 frames a second, in every second", float(whole.mean())),
        Expectation("the same at 5 frames a second", float(half.mean())),
        Expectation("standard deviation over seeds, the larger of both", deviation),
        Expectation("IDF1 lost at 5 frames a second, in these", lost, "<=", 1.0),
    ]


def detector_expectations(
    film: str, wanted: tuple[float, float], switches: float | None, scores: BySeed
) -> list[Expectation]:
    """Return what is expected of the model with a detector: IDF1 and MOTA, perhaps identity switches."""
    if DETECTED not in scores:
        return []
    ours = scores[DETECTED]
    idf1, mota, plain = mean(ours, "idf1"), mean(ours, "mota"), mean(scores[f"{PLAIN}, best IDF1"], "idf1")
    lost, above_cut = (idf1 - mean(scores[name], "idf1") for name in (RARE, CUT))
    plain_lost = plain - mean(scores[f"{RARE_PLAIN}, best IDF1"], "idf1")
    above = mota - mean(scores[f"{PLAIN}, best MOTA"], "mota")
    expectations = [
        Expectation(f"{film} with a detector: IDF1", idf1, ">=", wanted[0]),
        Expectation(f"{film} with a detector: MOTA", mota, ">=", wanted[1]),
        Expectation(f"{film}: IDF1 over plain association", ratio(idf1, plain), ">=", 1.15),
        Expectation(f"{film}: MOTA above plain association", above, ">=", 0.04),
        Expectation(f"{film}: IDF1 lost with the detector on every fifth frame", lost, "<=", 0.03),
        Expectation(f"{film}: the same of plain association", plain_lost),
        Expectation(f"{film}: IDF1 above feed-forward with the detector", above_cut, ">=", 0.05),
    ]
    if switches is not None:
        what = f"{film} with a detector: id switches"
        expectations.append(Expectation(what, mean(ours, "switches"), "<=", switches))
    return expectations


def _expectations_of_crowd(scores: BySeed) -> list[Expectation]:
    """What is wanted on TUD-Campus."""
    name = "TUD-Campus without a detector, whole film"
    return [
        *detector_expectations("TUD-Campus", (0.70, 0.62), None, scores),
        Expectation(f"{name}: IDF1", mean(scores[WHOLE], "idf1"), ">=", 0.5),
        Expectation(f"{name}: MOTA", mean(scores[WHOLE], "mota"), ">=", 0.3),
    ]
