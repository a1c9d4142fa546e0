"""Any films with ground truth: feedback beside feed-forward, other methods, and plain association."""

import json
import os
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from ...models.files import MOST_TEXT, read_text
from ..background.job import WHOLE_FILM
from ..background.parameters import Parameters, read_parameters, with_defaults
from ..batch.sources import FILMS, FilmSource, folder_names
from ..evaluation.masks import PixelScore
from ..evaluation.scoring import scoring_of
from ..evaluation.tracks import evaluate_tracks
from ..io.detections import last_frame
from ..io.files import write_json
from ..io.ground_truth import common_frames
from ..io.sources.open_source import Source, fingerprint, open_source
from ..io.tables import digest
from ..options.complaints import reason
from ..runs.parallel import Task, whatever_fails
from ..runs.session import versions
from .baselines import CleanUp, Setting
from .compare import CHAINS, TRACKS, Model
from .experiment import Findings, Plot, publish, shaken
from .pets import (
    DETECTED,
    PLAIN,
    WHOLE,
    WHOLE_DETECTED,
    AnnotatedFilm,
    Tracks,
    associated,
    online_tracks,
    read_film,
    whole_film_tracks,
)
from .record import ROOT, TRACKING, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Measures = dict[str, float]
Run = tuple[str, str, int | None]
"""A film's name, a method, and a seed of noise; without one, the film is as it is."""

EXPECTED = (
    "expected input/ and groundtruth/ (CDnet), or img1/ or a video and gt/gt.txt or gt.txt (MOTChallenge), "
    "in it or in folders below"
)
ABOUT = ("ROI.bmp", "temporalROI.txt", "gt/gt.txt", "gt.txt", "det/det.txt", "det.txt", "seqinfo.ini")
MEASURED = "measured.json"
FEED_FORWARD, FEEDBACK = (name for name, _ in CHAINS)

SUBTRACTORS = {
    f"{name}, 5x5 median": Setting(name, 500, threshold, CleanUp(median=5))
    for name, threshold in (("MOG2", 16), ("KNN", 400))
}
"""With OpenCV's own settings."""

USUAL_PLAIN = (0.2, (0.1, 3, 20))
SWEPT = tuple(
    (quantile, parameters)
    for quantile in (0.0, 0.1, 0.2, 0.3, 0.4)
    for parameters in ((0.1, 1, 10), (0.1, 3, 10), (0.1, 3, 20), (0.3, 3, 10))
)
BEST_PLAIN = f"{PLAIN}, best of {len(SWEPT)}"
"""Association with the best of these settings on the very film, for each measure: the strongest opponent.
They are those of `pets.ASSOCIATIONS` and some beside them; `USUAL_PLAIN` is in their middle."""


@dataclass(frozen=True)
class Kind:
    """What is measured of films with one kind of truth."""

    name: str
    measures: Sequence[str]  # the first is drawn
    pairs: Sequence[tuple[str, str]]  # of methods that are compared; the first pair is joined by a line


MASKS = Kind(
    "masks",
    ("F", "precision", "recall"),
    [(our, other) for our in (FEEDBACK, WHOLE) for other in (FEED_FORWARD, *SUBTRACTORS)],
)
BOXES = Kind(
    "tracks",
    ("HOTA", "MOTA", "IDF1"),
    [(our, other) for our in (DETECTED, WHOLE_DETECTED) for other in (PLAIN, BEST_PLAIN)]
    + [(DETECTED, FEEDBACK), (WHOLE_DETECTED, WHOLE)],
)

# --- films and what is measured of them ---------------------------------------------------------------------


@dataclass(frozen=True)
class TrueFilm:
    """Film with ground truth, in a folder as CDnet or MOTChallenge have it."""

    name: str
    folder: Path

    @property
    def kind(self) -> Kind:
        """Boxes are taken where there are masks too."""
        return BOXES if _has_boxes(self.folder) else MASKS

    @property
    def source(self) -> str:
        """The pictures' folder, or the only video of a folder without."""
        pictures = self.folder / ("img1" if self.kind is BOXES else "input")
        videos = [each for each in sorted(self.folder.iterdir()) if each.suffix.lower() in FILMS]
        return str(videos[0] if len(videos) == 1 and not pictures.is_dir() else pictures)

    @property
    def detections(self) -> Path:
        """The file of the detector's boxes, if there is one."""
        name = "det.txt"
        return self.folder / name if (self.folder / name).exists() else self.folder / "det" / name

    def methods(self, whole: bool) -> list[str]:
        """Return the methods that are tried on it; with those of whole films, if they are wanted."""
        if self.kind is MASKS:
            return [FEED_FORWARD, FEEDBACK, *[WHOLE] * whole, *SUBTRACTORS]
        detected = [DETECTED, *[WHOLE_DETECTED] * whole, PLAIN, BEST_PLAIN]
        return [FEEDBACK, *[WHOLE] * whole, *(detected if self.detections.exists() else [])]

    def known_by(self) -> list[Any]:
        """Return by which it shows whether film or truth are others; OSError if a part is not there."""
        masks = [fingerprint(str(self.folder / "groundtruth"))] if self.kind is MASKS else []
        files = [self.folder / name for name in ABOUT]
        return [fingerprint(self.source), *masks, *(digest(each) for each in files if each.is_file())]


def _has_boxes(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ("gt/gt.txt", "gt.txt"))


def find_films(folders: Sequence[Path]) -> list[TrueFilm]:
    """Return the films in folders and in those below, each once, by names that tell them apart.

    Raises
    ------
    ValueError
        if there is no folder, or one is not there or holds none; it says what was expected.
    """
    found: dict[Path, Path] = {}
    if not folders:
        raise ValueError(f"films: got no folder, {EXPECTED}")
    for folder in folders:
        inside = []
        for path, below, _ in os.walk(folder.absolute(), followlinks=True):
            below.sort()
            if _has_boxes(Path(path)) or "groundtruth" in below:
                inside.append(Path(path))
                below.clear()
        if not inside:
            what = "holds no film with ground truth" if folder.is_dir() else "no such folder"
            raise ValueError(f"{folder}: {what}, {EXPECTED}")
        for each in inside:
            found.setdefault(each.resolve(), each)
    names = folder_names([FilmSource(str(folder)) for folder in found.values()], {})
    return [TrueFilm(name, folder) for name, folder in zip(names, found.values(), strict=True)]


def score(film: TrueFilm, method: str, seed: int | None, parameters: Parameters) -> Measures:
    """Return a film's measures with a method; `parameters` are those of our chains.

    It is a ValueError or OSError, in one line, if something is wrong with the film.
    """
    return (_score_masks if film.kind is MASKS else _score_tracks)(film, method, seed, parameters)


def _score_masks(film: TrueFilm, method: str, seed: int | None, parameters: Parameters) -> Measures:
    with open_source(film.source) as source:
        scoring = scoring_of(film.folder, source, 1, 1, None)
        assert scoring is not None
        truth: Any = scoring.truth
        score, last = PixelScore(), truth.frames[-1]
        for number, mask in _masks(source, method, seed, parameters):
            if number in truth:
                score.add(number, mask, truth.labels(number))
            if number >= last:
                break
    total = score.total()
    return {"F": total.f_measure, "precision": total.precision, "recall": total.recall}


def _masks(
    source: Source, method: str, seed: int | None, parameters: Parameters
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Number and mask of each frame; where a frame is missing, a subtractor's mask stays as it was."""
    if method in SUBTRACTORS:
        setting, mask = SUBTRACTORS[method], np.zeros(source.size[::-1], np.uint8)
        subtractor = setting.make()
        for frame in shaken(source, seed):
            if frame.image is not None:
                mask = setting.clean_up.apply(subtractor.apply(frame.image))
            yield frame.number, mask
        return
    state = read_film(source, partial(shaken, seed=seed), parameters)[0] if method == WHOLE else None
    engine = WHOLE_FILM if method == WHOLE else dict(CHAINS)[method]
    model = Model(method, engine, source.size, parameters, state=state)
    for frame in shaken(source, seed):
        yield frame.number, model.step(frame).foreground


def _score_tracks(film: TrueFilm, method: str, seed: int | None, parameters: Parameters) -> Measures:
    known = AnnotatedFilm.read(film.name, Path(film.source), film.folder, film.detections)
    with open_source(film.source) as source:
        last = last_frame(source, 1, None, 1)
    judged = known.truth.frames if last is None else common_frames(known.truth, range(1, last + 1))

    def measures(tracks: Tracks) -> Measures:
        scores = evaluate_tracks(tracks, known.truth, judged)
        return {name: getattr(scores, TRACKS[name]) for name in BOXES.measures}

    if method == BEST_PLAIN:
        tried = [measures(associated(known, 1, *setting)) for setting in SWEPT]
        return {name: float(np.fmax.reduce([each[name] for each in tried])) for name in BOXES.measures}
    if method == PLAIN:
        return measures(associated(known, 1, *USUAL_PLAIN))
    every = 1 if method in (DETECTED, WHOLE_DETECTED) else None
    if method in (WHOLE, WHOLE_DETECTED):
        return measures(whole_film_tracks(known, every, seed, parameters))
    make = partial(Model, method, "recursive-bp", parameters=parameters)
    return measures(online_tracks(known, make, 1, every, seed))


# --- many films ---------------------------------------------------------------------------------------------


def run_films(
    folders: Sequence[Path], out: Path, *, whole: bool = False, seeds: int = 0, config: Path | None = None
) -> int:
    """Measure all films in folders; leave tables, plots and page in a folder.

    What was measured with the same code and settings is not measured again; a film that fails stops no other.

    Parameters
    ----------
    folders
        as of `find_films`.
    out
        folder of the results, made if need be.
    whole
        also the model of whole films.
    seeds
        of noise; without any, films are as they are.
    config
        TOML file with parameters of our chains.

    Returns
    -------
    1 if a film has failed, which standard error says too, otherwise 0.

    Raises
    ------
    ValueError, OSError
        in one line, if there are no films or parameters are wrong, or something cannot be written.
    """
    if seeds < 0:
        raise ValueError(f"seeds: got {seeds}, expected 0 or more")
    films, parameters = find_films(folders), read_parameters(config)
    words = [*["--whole-film"] * whole, *(["--seeds", str(seeds)] if seeds else [])]
    words += ["--config", str(config)] if config is not None else []
    command = shlex.join(["rsmcm", "reproduce", "films", *map(str, folders), *words])
    failed: dict[str, str] = {}

    def run() -> Findings:
        tried = range(seeds) if seeds else (None,)
        scores = _measure(films, out / MEASURED, whole, tried, parameters, failed)
        return summarise(films, scores, failed)

    publish("films", command, out, run)
    for name, why in failed.items():
        print(f"rsmcm: {name}: {why}", file=sys.stderr)
    return int(bool(failed))


def _measure(
    films: Sequence[TrueFilm],
    path: Path,
    whole: bool,
    seeds: Iterable[int | None],
    parameters: Parameters,
    failed: dict[str, str],
) -> dict[tuple[str, str], list[Measures]]:
    """Scores of each film and method, one for each seed; why films have `failed` is written there."""
    kept = _kept(path)
    code = [digest(ROOT / package, "**/*.py") for package in (*TRACKING, "apps")]
    settings = [code, versions(), with_defaults(parameters)]
    keys: dict[Run, str] = {}
    work: dict[Run, Task] = {}
    for film in films:
        try:
            known = film.known_by()
        except (ValueError, OSError) as error:
            failed[film.name] = reason(error)
            continue
        for method in film.methods(whole):
            for seed in [None] if method in (PLAIN, BEST_PLAIN) else seeds:  # which see no pictures
                run = (film.name, method, seed)
                text = json.dumps([settings, known, method, seed], default=str)
                keys[run] = sha256(text.encode()).hexdigest()
                if keys[run] not in kept:
                    work[run] = (score, (film, method, seed, parameters))
    with closing(whatever_fails("films", work, "runs")) as ended:
        for run, result in ended:
            if isinstance(result, Exception):
                failed.setdefault(run[0], reason(result))
                continue
            finite = {name: value for name, value in result.items() if np.isfinite(value)}  # as JSON can have
            kept[keys[run]] = {"film": run[0], "method": run[1], "seed": run[2], "measures": finite}
            write_json(path, kept)
    scores: dict[tuple[str, str], list[Measures]] = {}
    for (name, method, _), key in keys.items():
        if name not in failed:
            scores.setdefault((name, method), []).append(kept[key]["measures"])
    return scores


def _kept(path: Path) -> dict[str, Any]:
    """Scores of earlier calls by what they depend on."""
    if not path.exists():
        return {}
    try:
        kept: dict[str, Any] = json.loads(read_text(path, "expected scores of films", MOST_TEXT))
        if any(not isinstance(each["measures"], dict) for each in kept.values()):
            raise TypeError("measures")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: got {error!r}, expected scores of an earlier call, or no file") from None
    return kept


# --- what comes out -----------------------------------------------------------------------------------------


def summarise(
    films: Sequence[TrueFilm],
    scores: Mapping[tuple[str, str], Sequence[Measures]],
    failed: Mapping[str, str],
) -> Findings:
    """Return comparisons of methods, tables of all measures and of films that `failed`, and plots.

    `scores` are by name of a film and method, one for each seed of noise.
    """
    comparisons: list[Sequence[object]] = []
    tables, plots = [], []
    for kind in (MASKS, BOXES):
        names = [film.name for film in films if film.kind is kind and film.name not in failed]
        methods = list(dict.fromkeys(method for name, method in scores if name in names))
        for measure in kind.measures if methods else ():
            columns = {  # mean and standard deviation of each film
                method: np.array([_over_seeds(scores.get((name, method), ()), measure) for name in names]).T
                for method in methods
            }
            lines: list[Sequence[object]] = [
                [name, *(_cell(*column[:, row]) for column in columns.values())]
                for row, name in enumerate(names)
            ]
            means = np.array([column[0] for column in columns.values()])
            known = np.isfinite(means).all(axis=0)
            if known.any():
                lines.append([f"mean of {known.sum()}", *means[:, known].mean(axis=1).tolist()])
            tables.append(Table(("film", *methods), lines, f"{measure} of {kind.name}."))
            comparisons += [
                (measure, our, other, *compare(columns[our][0], columns[other][0]))
                for our, other in kind.pairs
                if our in columns and other in columns
            ]
            if measure == kind.measures[0]:
                plots.append(_plot(kind, names, columns))
    caption = (
        "Methods compared over films: means, on how many films the first is better and worse, and p of "
        "Wilcoxon's signed-rank test (two-sided; of n films at least 2^(1 - n)). Below, ± is the "
        "standard deviation over seeds of noise."
    )
    header = ("measure", "method", "against", "films", "mean", "mean of the other", "better", "worse", "p")
    if comparisons:
        tables.insert(0, Table(header, comparisons, caption))
    if failed:
        tables.append(Table(("film", "reason"), list(failed.items()), "Films that failed and count nowhere."))
    return Findings(f"Feedback on {len(films)} films", tables, [], plots)


def _over_seeds(scores: Sequence[Measures], measure: str) -> tuple[float, float]:
    """Mean and standard deviation; NaN where there is none."""
    values = [each.get(measure, np.nan) for each in scores] or [np.nan]
    return float(np.mean(values)), float(np.std(values, ddof=1)) if len(values) > 1 else np.nan


def _cell(mean: float, spread: float) -> object:
    return float(mean) if np.isnan(spread) else f"{mean:.3f} ± {spread:.3f}"


def compare(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> tuple[int, float, float, int, int, float]:
    """Compare two methods by a measure of each film, `(n,)`, on the films where both have one.

    Returns
    -------
    number of films; means of both; on how many films the first is better, and worse; p of Wilcoxon's
    signed-rank test, two-sided, NaN if no film tells them apart.
    """
    both = np.isfinite(first) & np.isfinite(second)
    difference = (first - second)[both]
    p = float(wilcoxon(difference).pvalue) if difference.any() else np.nan
    means = [float(each[both].mean()) if both.any() else np.nan for each in (first, second)]
    better, worse = (int(np.count_nonzero(each)) for each in (difference > 0, difference < 0))
    return len(difference), means[0], means[1], better, worse, p


STYLES = {
    FEED_FORWARD: ("o", "#e0a030"),
    FEEDBACK: ("D", "#2f7fc1"),
    WHOLE: ("s", "#2f7fc1"),
    DETECTED: ("D", "#1b3f66"),
    WHOLE_DETECTED: ("s", "#1b3f66"),
    PLAIN: ("^", "#c1453b"),
    BEST_PLAIN: ("v", "#c1453b"),
    **dict(zip(SUBTRACTORS, (("^", "#7a9e3d"), ("v", "#7a9e3d")), strict=True)),
}
"""Marker and colour of each method."""


def _plot(kind: Kind, names: Sequence[str], columns: Mapping[str, NDArray[np.float64]]) -> Plot:
    """Every film in a row, with `(2, films)` means and deviations; a line joins the first pair of methods."""
    ends = [columns[each][0] for each in kind.pairs[0] if each in columns] or [np.full(len(names), np.nan)]
    order = np.argsort(ends[0] - ends[-1])  # the greatest gain on top

    def draw(canvas: "Figure") -> None:
        axes: Axes = canvas.subplots()
        rows = np.arange(len(names))
        axes.plot([end[order] for end in ends], [rows] * len(ends), color="#9aa0a6", linewidth=2, zorder=1)
        for method, (mean, spread) in columns.items():
            marker, colour = STYLES[method]
            axes.errorbar(mean[order], rows, xerr=spread[order], fmt=marker, color=colour, label=method)
        axes.set_yticks(rows, [names[film] for film in order])
        axes.set_ylim(-0.6, len(names) - 0.4)
        axes.set_xlabel(kind.measures[0])
        canvas.legend(loc="outside upper center", ncols=3)

    caption = f"{kind.measures[0]} of {kind.name}, film by film"
    return Plot(f"films-{kind.name}.png", draw, (9, 1.6 + 0.3 * len(names)), caption)
