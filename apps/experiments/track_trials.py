"""Tracks of a film by several methods, each over seeds of noise: a score is a mean, with its spread.

Tracks are chaotic: one grey level in one of a thousand pixels moves their scores by some hundredths.
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
from ..evaluation.masks import ratio
from ..evaluation.tracks import TrackScores, evaluate_tracks
from ..io.detections import Detections, read_detections, with_boxes
from ..io.ground_truth import BoxTruth, read_ground_truth
from ..io.sources.open_source import open_source
from ..runs.interruption import Interruption
from ..runs.parallel import in_parallel
from .baselines import CleanUp, KalmanHungarian, Setting, component_boxes
from .compare import CHAINS, Model
from .expectations import Expectation

Tracks = NDArray[np.float64]
"""`(n, 6)`: frame, identity, x, y, width, height (px)."""

NOISE_SEEDS = range(5)

MEASURES = {"IDF1": "idf1", "HOTA": "hota", "MOTA": "mota", "id switches": "switches"}
"""Attributes of `TrackScores` by what they are called in tables."""


@dataclass(frozen=True, eq=False)
class AnnotatedFilm:
    """A film whose objects are known.

    Parameters
    ----------
    name
        for tables.
    source
        as of `open_source`.
    truth
        the true boxes.
    detections
        what a detector has found in it, if that is known.
    """

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
        """Its frames with noise; with the detector's boxes on every `every`-th, if that is given."""
        with open_source(self.source, step=step) as source:
            yield from self.known(source, seed, every)

    def known(self, frames: Iterable[Frame], seed: int, every: int | None) -> Iterator[Frame]:
        """The same of frames that are open."""
        shaken = (noisy(frame, seed) for frame in frames)
        if every is None:
            return shaken
        assert self.detections is not None
        return with_boxes(shaken, self.detections, every)


@dataclass(frozen=True)
class Trial:
    """A method to be tried.

    Parameters
    ----------
    name, described
        the method, and how it is set, for tables.
    tracks
        makes tracks of a seed of noise; can be sent to another process.
    seeds
        one is enough for methods that see no pictures.
    step
        only every `step`-th frame is judged, where it sees no others.
    """

    name: str
    described: str
    tracks: Callable[[int], Tracks]
    seeds: Sequence[int] = NOISE_SEEDS
    step: int = 1


BySeed = Mapping[str, Sequence[TrackScores]]
"""Scores of methods by name, one for each seed."""


def mean(scores: Sequence[TrackScores], measure: str) -> float:
    """Of an attribute of `TrackScores` over seeds."""
    return float(np.mean([getattr(each, measure) for each in scores]))


def cells(scores: Sequence[TrackScores]) -> list[str]:
    """A table's cells of `MEASURES`: mean and, of several seeds, standard deviation."""
    found = []
    for measure in MEASURES.values():
        digits, values = 1 if measure == "switches" else 3, [getattr(each, measure) for each in scores]
        spread = f" ± {np.std(values, ddof=1):.{digits}f}" if len(values) > 1 else ""
        found.append(f"{np.mean(values):.{digits}f}{spread}")
    return found


def run_trials(label: str, trials: Sequence[Trial]) -> dict[str, list[Tracks]]:
    """The tracks of all trials by name, one table a seed; worked out in several processes."""
    work = [(trial.tracks, (seed,)) for trial in trials for seed in trial.seeds]
    made = iter(in_parallel(label, work))
    return {trial.name: [next(made) for _ in trial.seeds] for trial in trials}


def score_trials(
    trials: Sequence[Trial], tracks: Mapping[str, Sequence[Tracks]], truth: BoxTruth
) -> dict[str, list[TrackScores]]:
    """Scores of all trials by name, one for each seed."""
    found = {}
    for trial in trials:
        judged = [number for number in truth.frames if (number - 1) % trial.step == 0]
        found[trial.name] = [evaluate_tracks(table, truth, judged) for table in tracks[trial.name]]
    return found


def noisy(frame: Frame, seed: int) -> Frame:
    """The frame with one grey level more or less in one of a thousand pixels."""
    if frame.image is None:
        return frame
    random = np.random.default_rng([seed, frame.number])
    image = frame.image.reshape(-1, frame.image.shape[-1] if frame.image.ndim == 3 else 1).astype(np.int16)
    changed = random.choice(len(image), len(image) // 1000, replace=False)
    image[changed] += random.choice(np.array([-1, 1], np.int16), len(changed))[:, None]
    return replace(frame, image=image.clip(0, 255).astype(np.uint8).reshape(frame.image.shape))


# --- methods ------------------------------------------------------------------------------------------------


def model_tracks(film: AnnotatedFilm, engine: Engine, step: int, every: int | None, seed: int) -> Tracks:
    """Tracks by a multi-chain model, which sees every `step`-th frame, and the detector's boxes perhaps."""
    system: Model | None = None
    rows: list[tuple[float, ...]] = []
    for frame in film.frames(seed, step, every):
        if system is None:
            assert frame.image is not None
            system = Model("", engine, (frame.image.shape[1], frame.image.shape[0]))
        rows += [(frame.number, each.identity, *each.box) for each in system.step(frame).tracks]
    return _table(rows)


def whole_film_tracks(film: AnnotatedFilm, every: int | None, seed: int) -> Tracks:
    """Tracks by the model that reads the film as a whole, with the detector's boxes perhaps."""
    job = BackgroundJob(film.source, out=Path(), engine=WHOLE_FILM)  # nothing is written
    with open_source(film.source) as source:
        _, objects = read_whole(
            job,
            source,
            build_model(job.engine),
            lambda frames: film.known(frames, seed, every),
            Interruption(),
        )
        count = source.n_frames
    assert count is not None
    return _table(
        [(index + 1, track.identity, *track.box) for index in range(count) for track in objects.at(index)]
    )


def usual_tracks(
    film: AnnotatedFilm, setting: Setting, clean_up: CleanUp, parameters: tuple[float, int, int], seed: int
) -> Tracks:
    """Tracks by a subtractor, a clean-up, Kalman filters and assignment."""
    subtractor, tracker = setting.make(), KalmanHungarian(*parameters)
    rows: list[tuple[float, ...]] = []
    for frame in film.frames(seed):
        if frame.image is not None:
            boxes = component_boxes(clean_up.apply(subtractor.apply(frame.image)))
            rows += [(frame.number, *track) for track in tracker.update(boxes).tolist()]
    return _table(rows)


# --- association of detections without pictures -------------------------------------------------------------

SCORE_QUANTILES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
ASSOCIATIONS = tuple(product((0.1, 0.3), (1, 3, 5), (10, 20)))
"""Least overlap, hits from which a track counts, frames without a find after which it ends."""


def associated(
    film: AnnotatedFilm, every: int, quantile: float, parameters: tuple[float, int, int], seed: int = 0
) -> Tracks:
    """Tracks by Kalman filters and assignment of the detector's boxes on every `every`-th frame.

    Parameters
    ----------
    film
        with detections.
    every
        in between, tracks are where their filters predict them.
    quantile
        share of the boxes that is left out, those with the lowest scores.
    parameters
        of `KalmanHungarian`.
    seed
        is not used: nothing is seen of the pictures.
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
    """What plain association is best with on this film, in IDF1 and in MOTA: in words, and its tracks."""
    combined = list(product(SCORE_QUANTILES, ASSOCIATIONS))
    work = [(_association_scores, (film, every, *each)) for each in combined]
    scores: list[TrackScores] = in_parallel(f"{film.name}, association", work)
    best = {}
    for title in ("IDF1", "MOTA"):
        values = [getattr(each, MEASURES[title]) for each in scores]
        quantile, parameters = combined[int(np.argmax(values))]
        overlap, hits, age = parameters
        described = f"lowest {quantile:.0%} left out; overlap {overlap}, hits {hits}, age {age}"
        best[title] = described, partial(associated, film, every, quantile, parameters)
    return best


def _association_scores(
    film: AnnotatedFilm, every: int, quantile: float, parameters: tuple[float, int, int]
) -> TrackScores:
    return evaluate_tracks(associated(film, every, quantile, parameters), film.truth)


# --- what is compared of a film with a detector -------------------------------------------------------------

FIFTH = 5
WHOLE, WHOLE_DETECTED = "RSMCM, whole film", "RSMCM, whole film, detector"
DETECTED, CUT, RARE = "RSMCM, detector", "feed-forward, detector", "RSMCM, detector on every fifth frame"
PLAIN, RARE_PLAIN = "association", "association, every fifth frame"


def pixel_trials(film: AnnotatedFilm) -> list[Trial]:
    """The model without a detector: with and without feedback, and reading the film as a whole."""
    trials = [Trial(name, "", partial(model_tracks, film, engine, 1, None)) for name, engine in CHAINS]
    return [*trials, Trial(WHOLE, "", partial(whole_film_tracks, film, None))]


def detector_trials(film: AnnotatedFilm) -> list[Trial]:
    """The model with the detector, on every frame and every fifth, and plain association of the same boxes.

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


def detector_expectations(
    film: str, wanted: tuple[float, float], switches: float | None, found: BySeed
) -> list[Expectation]:
    """What is wanted of the model with a detector: IDF1 and MOTA, identity switches perhaps."""
    if DETECTED not in found:
        return []
    ours, plain = found[DETECTED], found[f"{PLAIN}, best IDF1"]
    idf1, mota = mean(ours, "idf1"), mean(ours, "mota")
    lost = idf1 - mean(found[RARE], "idf1")
    plain_lost = mean(plain, "idf1") - mean(found[f"{RARE_PLAIN}, best IDF1"], "idf1")
    times = ratio(idf1, mean(plain, "idf1"))
    above = mota - mean(found[f"{PLAIN}, best MOTA"], "mota")
    expectations = [
        Expectation(f"{film} with a detector: IDF1", idf1, ">=", wanted[0]),
        Expectation(f"{film} with a detector: MOTA", mota, ">=", wanted[1]),
        Expectation(f"{film}: IDF1 over plain association", times, ">=", 1.15),
        Expectation(f"{film}: MOTA above plain association", above, ">=", 0.04),
        Expectation(f"{film}: IDF1 lost with the detector on every fifth frame", lost, "<=", 0.03),
        Expectation(f"{film}: the same of plain association", plain_lost),
        Expectation(
            f"{film}: IDF1 above feed-forward with the detector", idf1 - mean(found[CUT], "idf1"), ">=", 0.05
        ),
    ]
    if switches is not None:
        what = f"{film} with a detector: id switches"
        expectations.append(Expectation(what, mean(ours, "switches"), "<=", switches))
    return expectations


def _table(rows: Sequence[tuple[float, ...]]) -> Tracks:
    return np.array(rows, np.float64).reshape(-1, 6)
