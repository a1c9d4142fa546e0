"""Trials of tracks: scores are means over seeds, boxes come when they should, and the best is best."""

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
from rsmcm.apps.experiments.compare import Model
from rsmcm.apps.experiments.experiment import noisy
from rsmcm.apps.experiments.pets import (
    AnnotatedFilm,
    Trial,
    associated,
    cells,
    count_errors,
    detector_trials,
    online_tracks,
    run_trials,
    score_trials,
    whole_film_tracks,
)
from rsmcm.apps.io.files import PLAYABLE, SegmentedVideo
from rsmcm.apps.io.tracks import read_tracks
from rsmcm.apps.scenes import sleeping_man
from rsmcm.models.core.frame import Frame

from ...support.two_people import two_people

N_FRAMES = 30
ONE_HIT = (0.1, 1, 10)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> AnnotatedFilm:
    """Two people who walk past each other, by their boxes; the pictures show somebody else."""
    folder = tmp_path_factory.mktemp("film")
    write_scene(sleeping_man(N_FRAMES, size=(128, 96), enter=0), folder)
    truth, detected = two_people(N_FRAMES, (20, 20), (90, 50), 90)
    (folder / "gt.txt").write_text(truth)
    (folder / "det.txt").write_text(detected)
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
    assert np.abs(difference).max() == 1


def test_the_detector_looks_at_every_fifth_frame(film: AnnotatedFilm) -> None:
    frames = [Frame(np.zeros((9, 9), np.uint8), number / 25, number) for number in range(1, 13)]
    with_some = {frame.number: frame.boxes for frame in film.prepare(frames, 0, every=5)}
    assert [number for number, boxes in with_some.items() if boxes] == [1, 6, 11]
    assert all(frame.boxes is None for frame in film.prepare(frames, 0, every=None))


@pytest.mark.parametrize("every", [1, 5])
def test_plain_association_follows_what_is_detected(film: AnnotatedFilm, every: int) -> None:
    """Boxes with low scores are left out; between the looks, the filters go on at a constant speed."""
    scores = evaluate_tracks(associated(film, every, 0.34, ONE_HIT), film.truth)
    assert scores.idf1 == pytest.approx(1.0, abs=0.05 if every == 1 else 0.25)
    assert scores.misses == 0 or every == 5
    assert evaluate_tracks(associated(film, every, 0.0, ONE_HIT), film.truth).idf1 < scores.idf1


def test_errors_are_counted_in_every_tenth_frame(
    film: AnnotatedFilm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trials, "FIRST_COUNTED", 10)
    for name in ("RSMCM", "MOG2"):
        (errors,) = count_errors(film, name, 0).values()
        assert errors.objects == 6, "two people in frames 10, 20 and 30"
    bare = AnnotatedFilm(film.name, film.source, film.truth)
    assert detector_trials(bare) == [], "without detections there are no trials of a detector"


def test_scores_are_means_with_their_standard_deviation(film: AnnotatedFilm) -> None:
    runs = [associated(film, 1, 0.34, (0.1, hits, 10)) for hits in (1, 3, 5)]
    scores = [evaluate_tracks(run, film.truth) for run in runs]
    values = [each.idf1 for each in scores]
    assert cells(scores)[0] == f"{np.mean(values):.3f} ± {np.std(values, ddof=1):.3f}"
    assert "±" not in cells(scores[:1])[0]


def test_a_method_that_sees_every_second_frame_is_judged_in_these(film: AnnotatedFilm) -> None:
    tracks = associated(film, 1, 0.34, ONE_HIT)
    half = Trial("half", "", partial(associated, film, 1, 0.34, ONE_HIT), (0,), step=2)
    (scores,) = score_trials([half], {"half": [tracks[tracks[:, 0] % 2 == 1]]}, film.truth)["half"]
    assert (scores.n_frames, scores.misses) == (N_FRAMES // 2, 0)


@pytest.mark.usefixtures("in_this_process")
def test_every_seed_of_a_trial_is_run(film: AnnotatedFilm) -> None:
    run = partial(online_tracks, film, partial(Model, "RSMCM", "recursive-bp"), 1, 1)
    plain = Trial("plain", "", partial(associated, film, 1, 0.0, ONE_HIT), (0,))
    tracks = run_trials("test", [Trial("model", "", run, (3, 4)), plain])
    assert [len(tracks[name]) for name in ("model", "plain")] == [2, 1]
    np.testing.assert_array_equal(tracks["model"][1], run(4))
    np.testing.assert_array_equal(tracks["plain"][0], associated(film, 1, 0.0, ONE_HIT))


def test_a_film_as_a_whole_is_that_of_the_application(film: AnnotatedFilm, tmp_path: Path) -> None:
    job = BackgroundJob(film.source, out=tmp_path / "out", engine="coordinate-ascent", masks="none")
    run_background(job)
    tracks = whole_film_tracks(film, None, None)
    assert len(tracks)
    written = track_rows(read_tracks(tmp_path / "out" / "tracks.txt"))
    np.testing.assert_allclose(tracks, written, atol=0.006)  # files have two digits


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
    video = SegmentedVideo(tmp_path / "pets2009-s2l1" / "vtest.avi", 25.0, PLAYABLE)
    for frame in sleeping_man(N_FRAMES, size=(128, 96), enter=0):
        assert frame.image is not None
        video.write(frame.image, frame.number, frame.time)
    video.close()
    monkeypatch.setenv("RSMCM_DATA", str(tmp_path))
    run_experiment("pets", tmp_path / "out")
    printed = capsys.readouterr().out
    assert "IDF1 lost with the detector on every fifth frame" in printed
    assert "TUD-Campus with a detector: IDF1" in printed
    assert (tmp_path / "out" / "compare-pictures.png").exists()
