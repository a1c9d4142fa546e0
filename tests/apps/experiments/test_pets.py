"""Trials of tracks: scores are means over seeds, boxes come when they should, and the best is best."""

from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.background.application import run_background
from rsmcm.apps.background.job import BackgroundJob
from rsmcm.apps.demo import write_scene
from rsmcm.apps.evaluation.tracks import evaluate_tracks, track_rows
from rsmcm.apps.experiments import pets as trials
from rsmcm.apps.experiments import run_experiment
from rsmcm.apps.experiments.pets import (
    AnnotatedFilm,
    Trial,
    associated,
    best_associations,
    cells,
    detector_trials,
    mean,
    model_tracks,
    noisy,
    run_trials,
    score_trials,
    whole_film_tracks,
)
from rsmcm.apps.io.files import PLAYABLE, SegmentedVideo
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.scenes import sleeping_man
from rsmcm.models.core.frame import Frame

N_FRAMES = 50


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> AnnotatedFilm:
    """Two people who walk past each other, by their boxes; the pictures are of somebody else."""
    folder = tmp_path_factory.mktemp("film")
    write_scene(sleeping_man(N_FRAMES, size=(192, 144), enter=0), folder)
    truth, found = "", ""
    for number in range(1, N_FRAMES + 1):
        for identity, (x, y) in enumerate(((20 + number, 20), (90 - number, 50)), start=1):
            truth += f"{number},{identity},{x},{y},12,30,1,-1,-1,-1\n"
            found += f"{number},-1,{x},{y},12,30,{20 + number % 3},-1,-1,-1\n"
        found += f"{number},-1,{1 + 37 * number % 90},{1 + 53 * number % 60},9,9,{number % 7},-1,-1,-1\n"
    (folder / "gt.txt").write_text(truth)
    (folder / "det.txt").write_text(found)
    return AnnotatedFilm.read("two", folder / "input", folder / "gt.txt", folder / "det.txt")


def test_noise_is_one_level_in_one_of_a_thousand_pixels() -> None:
    image = np.full((100, 80, 3), 7, np.uint8)
    first, again, other = (noisy(Frame(image, 0.0, 3), seed).image for seed in (1, 1, 2))
    assert first is not None
    assert other is not None
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    difference = first.astype(int) - image
    assert np.count_nonzero(difference.any(axis=2)) == 8
    assert set(np.unique(difference)) == {-1, 0, 1}


def test_the_detector_looks_at_every_fifth_frame(film: AnnotatedFilm) -> None:
    counts = {frame.number: frame.boxes for frame in film.frames(0, every=5)}
    looked = [number for number, boxes in counts.items() if boxes is not None]
    assert looked == list(range(1, N_FRAMES + 1, 5))
    assert all(len(boxes) == 3 for boxes in counts.values() if boxes is not None)
    assert all(frame.boxes is None for frame in film.frames(0))


@pytest.mark.parametrize("every", [1, 5])
def test_plain_association_follows_what_is_detected(film: AnnotatedFilm, every: int) -> None:
    """Boxes with low scores are left out; between the looks, the filters go on at a constant speed."""
    tracks = associated(film, every, 0.34, (0.1, 1, 10))
    scores = evaluate_tracks(tracks, film.truth)
    assert scores.idf1 == pytest.approx(1.0, abs=0.05 if every == 1 else 0.25)
    assert scores.misses == 0 or every == 5
    assert evaluate_tracks(associated(film, every, 0.0, (0.1, 1, 10)), film.truth).idf1 < scores.idf1


def test_the_best_association_is_the_best(film: AnnotatedFilm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trials, "SCORE_QUANTILES", (0.0, 0.34))
    monkeypatch.setattr(trials, "ASSOCIATIONS", ((0.1, 1, 10), (0.1, 5, 10)))
    every = {
        (quantile, parameters): evaluate_tracks(associated(film, 1, quantile, parameters), film.truth)
        for quantile in trials.SCORE_QUANTILES
        for parameters in trials.ASSOCIATIONS
    }
    for title, measure in (("IDF1", "idf1"), ("MOTA", "mota")):
        _, run = best_associations(film, 1)[title]
        chosen = evaluate_tracks(run(0), film.truth)
        assert getattr(chosen, measure) == max(getattr(each, measure) for each in every.values())


def test_scores_are_means_with_their_spread(film: AnnotatedFilm) -> None:
    runs = [associated(film, 1, 0.34, (0.1, hits, 10)) for hits in (1, 3, 5)]
    scores = [evaluate_tracks(run, film.truth) for run in runs]
    values = [each.idf1 for each in scores]
    assert mean(scores, "idf1") == np.mean(values)
    assert cells(scores)[0] == f"{np.mean(values):.3f} ± {np.std(values, ddof=1):.3f}"
    assert "±" not in cells(scores[:1])[0]


def test_a_method_that_sees_every_second_frame_is_judged_in_these(film: AnnotatedFilm) -> None:
    tracks = associated(film, 1, 0.34, (0.1, 1, 10))
    half = Trial("half", "", partial(associated, film, 1, 0.34, (0.1, 1, 10)), (0,), step=2)
    (scores,) = score_trials([half], {"half": [tracks[tracks[:, 0] % 2 == 1]]}, film.truth)["half"]
    assert scores.n_frames == N_FRAMES // 2
    assert scores.misses == 0


def test_trials_are_what_running_by_hand_gives(film: AnnotatedFilm) -> None:
    """In other processes, with the same noise."""
    run = partial(model_tracks, film, "recursive-bp", 1, 1)
    chosen = [
        Trial("model", "", run, (3, 4)),
        Trial("plain", "", partial(associated, film, 1, 0.0, (0.1, 1, 10)), (0,)),
    ]
    tracks = run_trials("test", chosen)
    assert [len(tracks[name]) for name in ("model", "plain")] == [2, 1]
    np.testing.assert_array_equal(tracks["model"][1], run(4))
    scored = score_trials(chosen, tracks, film.truth)
    by_hand = asdict(evaluate_tracks(run(4), film.truth))
    assert asdict(scored["model"][1]) == pytest.approx(by_hand, nan_ok=True)


def test_a_film_as_a_whole_is_that_of_the_application(film: AnnotatedFilm, tmp_path: Path) -> None:
    """But for the noise, which is one level here and there: the tracks are nearly the same."""
    job = BackgroundJob(film.source, out=tmp_path / "out", engine="coordinate-ascent", masks="none")
    run_background(job)
    written = track_rows(read_tracks(tmp_path / "out" / "tracks.txt"))
    tracks = whole_film_tracks(film, None, 0)
    assert len(tracks) > 10
    assert len(tracks) == pytest.approx(len(written), rel=0.2)
    assert set(tracks[:, 0]) <= set(range(1, N_FRAMES + 1))
    for row in tracks[len(tracks) // 2 :: 5]:
        same = written[written[:, 0] == row[0]]
        assert np.abs(same[:, 2:] - row[2:]).max(axis=1).min() < 4


def test_a_film_without_detections_has_no_trials_of_a_detector(film: AnnotatedFilm, tmp_path: Path) -> None:
    folder = Path(film.source).parent
    bare = AnnotatedFilm.read("bare", folder / "input", folder / "gt.txt", tmp_path / "none.txt")
    assert detector_trials(bare) == []


@pytest.mark.slow
def test_pets_on_a_small_film(
    film: AnnotatedFilm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole experiment, on films that have the names and files of the real ones."""
    folder = Path(film.source).parent
    for name in ("pets2009-s2l1", "tud-campus/gt", "tud-campus/det"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "tud-campus" / "img1").symlink_to(folder / "input")
    for name in (
        "pets2009-s2l1/gt.txt",
        "pets2009-s2l1/det.txt",
        "tud-campus/gt/gt.txt",
        "tud-campus/det/det.txt",
    ):
        (tmp_path / name).write_text((folder / Path(name).name).read_text())
    scene = sleeping_man(N_FRAMES, size=(192, 144), enter=0)
    video = SegmentedVideo(tmp_path / "pets2009-s2l1" / "vtest.avi", 25.0, PLAYABLE)
    for frame in scene:
        assert frame.image is not None
        video.write(frame.image, frame.number, frame.time)
    video.close(finished=True)
    monkeypatch.setenv("RSMCM_DATA", str(tmp_path))
    run_experiment("pets", tmp_path / "out")
    printed = capsys.readouterr().out
    for words in (
        "IDF1 lost with the detector on every fifth frame",
        "TUD-Campus with a detector: IDF1",
        "±",
    ):
        assert words in printed
    assert (tmp_path / "out" / "compare-pictures.png").exists()
