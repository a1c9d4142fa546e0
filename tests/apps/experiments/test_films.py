"""Any films with ground truth: what is found, measured, compared, kept, and told of films that are broken."""

import itertools
import json
import shutil
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.apps.background.application import run_background
from rsmcm.apps.background.job import BackgroundJob
from rsmcm.apps.command_line import main
from rsmcm.apps.demo import write_scene
from rsmcm.apps.experiments import experiment
from rsmcm.apps.experiments.compare import Model
from rsmcm.apps.experiments.films import (
    BEST_PLAIN,
    FEED_FORWARD,
    FEEDBACK,
    SUBTRACTORS,
    TrueFilm,
    compare,
    find_films,
    score,
    summarise,
)
from rsmcm.apps.experiments.pets import DETECTED, PLAIN, WHOLE
from rsmcm.apps.scenes import sleeping_man
from rsmcm.models import Frame

from ...support.films import start, wait_until
from ...support.two_people import two_people

N_FRAMES = 16
SIZE = (96, 72)
FIRST, LAST = 4, 12  # numbers of the masks that count
METHODS = [FEED_FORWARD, FEEDBACK, *SUBTRACTORS]
DETECTOR_METHODS = [FEEDBACK, DETECTED, PLAIN, BEST_PLAIN]


def write_masks(folder: Path) -> None:
    """A film in CDnet's layout, counted from 0, with a strip that is unknown and a shadow."""
    write_scene(sleeping_man(N_FRAMES, size=SIZE, enter=0), folder)
    for name, prefix in (("input", "in"), ("groundtruth", "gt")):
        for number in range(1, N_FRAMES + 1):  # upwards, so that none is replaced
            old = folder / name / f"{prefix}{number:06d}.png"
            old.rename(folder / name / f"{prefix}{number - 1:06d}.png")
    for path in (folder / "groundtruth").iterdir():
        labels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert labels is not None
        labels[:20] = 170
        labels[60:, :30] = 50
        cv2.imwrite(str(path), labels)
    (folder / "temporalROI.txt").write_text(f"{FIRST} {LAST}")


def write_boxes(folder: Path) -> None:
    """A film in MOTChallenge's layout: two people, and false boxes with low scores."""
    write_scene(sleeping_man(N_FRAMES, size=SIZE, enter=0), folder)
    shutil.rmtree(folder / "groundtruth")
    (folder / "input").rename(folder / "img1")
    truth, detected = two_people(N_FRAMES, (5, 20), (80, 40), 80)
    for name, text in (("gt", truth), ("det", detected)):
        (folder / name).mkdir()
        (folder / name / f"{name}.txt").write_text(text)
    (folder / "seqinfo.ini").write_text("[Sequence]\nname=two\nimDir=img1\nframeRate=25\n")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    write_masks(folder / "dataset" / "baseline" / "street")
    write_boxes(folder / "two")
    return folder


@pytest.fixture(scope="module")
def street(data: Path) -> TrueFilm:
    return TrueFilm("street", data / "dataset" / "baseline" / "street")


@pytest.fixture(scope="module")
def two(data: Path) -> TrueFilm:
    return TrueFilm("two", data / "two")


def code_of(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["reproduce", "films", *map(str, arguments)])
    return int(ended.value.code or 0)


def test_films_are_found_at_any_depth_and_once(data: Path, street: TrueFilm, two: TrueFilm) -> None:
    assert find_films([data]) == [street, two]
    assert find_films([data / "two", data / "dataset", data, data / ".." / data.name]) == [two, street]
    assert (Path(street.source).name, Path(two.source).name) == ("input", "img1")
    assert [street.methods(whole=False), two.methods(whole=False)] == [METHODS, DETECTOR_METHODS]
    assert set(street.methods(whole=True)) - set(METHODS) == {WHOLE}


def test_the_video_of_a_sequence_is_taken_where_it_has_no_pictures(tmp_path: Path) -> None:
    for name in ("gt.txt", "det.txt", "street.avi"):
        (tmp_path / name).touch()
    (film,) = find_films([tmp_path])
    assert (film.source, film.detections) == (str(tmp_path / "street.avi"), tmp_path / "det.txt")
    (tmp_path / "det.txt").unlink()
    assert film.methods(whole=False) == [FEEDBACK], "without detections, no method that needs them"


@pytest.mark.parametrize("what", ["holds no film with ground truth", "no such folder"])
def test_a_folder_that_is_neither_is_refused_in_one_line(
    tmp_path: Path, what: str, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "empty"
    if what != "no such folder":
        (folder / "img1").mkdir(parents=True)
    assert code_of(folder, "--out", tmp_path / "out") == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith(f"rsmcm: {folder}: {what}, expected input/ and groundtruth/ (CDnet), or img1/")
    assert code_of(folder, "--seeds", "-1") == 2
    assert capfd.readouterr().err == "rsmcm: --seeds: got -1, expected 0 or more\n"
    assert code_of("--out", tmp_path / "out") == 2
    assert capfd.readouterr().err.startswith("rsmcm: films: got no folder, expected input/ and groundtruth/")
    assert not (tmp_path / "out").exists()


def counted(street: TrueFilm, method: str) -> dict[str, float]:
    """Measures by hand: pictures and labels by the numbers in their names, unknown ones left out."""
    setting = SUBTRACTORS.get(method)
    subtractor = None if setting is None else setting.make()
    model = Model(method, "feed-forward" if method == FEED_FORWARD else "recursive-bp", SIZE)
    right = wrong = missed = 0
    for number in range(N_FRAMES):
        image = cv2.imread(str(street.folder / "input" / f"in{number:06d}.png"))
        assert image is not None
        if subtractor is None:
            mask = model.step(Frame(np.asarray(image, np.uint8), number / 25, number + 1)).foreground
        else:
            mask = cv2.medianBlur(np.where(subtractor.apply(image) == 255, np.uint8(255), np.uint8(0)), 5)
        if FIRST <= number <= LAST:
            path = street.folder / "groundtruth" / f"gt{number:06d}.png"
            labels = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
            right += int(((mask > 0) & (labels == 255)).sum())
            wrong += int(((mask > 0) & ((labels == 0) | (labels == 50))).sum())
            missed += int(((mask == 0) & (labels == 255)).sum())
    precision, recall = right / (right + wrong), right / (right + missed)
    return {"F": 2 * precision * recall / (precision + recall), "precision": precision, "recall": recall}


@pytest.mark.parametrize("method", METHODS)
def test_masks_are_scored_as_if_counted_by_hand(street: TrueFilm, method: str) -> None:
    assert score(street, method, None, {}) == pytest.approx(counted(street, method))


@pytest.mark.parametrize("number", [0, 7, N_FRAMES - 1])
def test_one_mask_is_enough(street: TrueFilm, tmp_path: Path, number: int) -> None:
    shutil.copytree(street.folder / "input", tmp_path / "input")
    (tmp_path / "groundtruth").mkdir()
    labels = np.full(SIZE[::-1], 170, np.uint8)
    labels[:36] = 255
    labels[36:40] = 0
    cv2.imwrite(str(tmp_path / "groundtruth" / f"gt{number:06d}.png"), labels)
    seen = []
    for index in range(number + 1):
        image = np.asarray(cv2.imread(str(tmp_path / "input" / f"in{index:06d}.png")), np.uint8)
        seen.append(Frame(image, index / 25, index + 1))
    model = Model(FEEDBACK, "recursive-bp", SIZE)
    mask = [model.step(frame).foreground for frame in seen][-1][:40] > 0
    found = score(TrueFilm("one", tmp_path), FEEDBACK, None, {})
    assert found["recall"] == pytest.approx(mask[:36].mean())
    if mask.any():
        assert found["precision"] == pytest.approx(mask[:36].sum() / mask.sum())


def test_association_is_scored_as_it_must_be(two: TrueFilm) -> None:
    """Of true boxes on two straight ways, the third of each is the first that counts; best of all at once."""
    third, first = (score(two, method, None, {}) for method in (PLAIN, BEST_PLAIN))
    assert third["MOTA"] == pytest.approx(1 - 2 / N_FRAMES)
    assert third["IDF1"] == pytest.approx(2 * (N_FRAMES - 2) / (N_FRAMES + N_FRAMES - 2))
    assert first["MOTA"] == first["IDF1"] == pytest.approx(1)


@pytest.mark.parametrize("method", [FEEDBACK, DETECTED, WHOLE])
def test_tracks_are_scored_as_a_run_of_the_application(two: TrueFilm, tmp_path: Path, method: str) -> None:
    job = BackgroundJob(
        two.source,
        out=tmp_path,
        engine="coordinate-ascent" if method == WHOLE else "recursive-bp",
        detections=two.detections if method == DETECTED else None,
        ground_truth=two.folder,
        masks="none",
    )
    measures = run_background(job).summary["metrics"]["tracks"]
    expected = {name: measures[name.lower()] for name in ("MOTA", "IDF1", "HOTA")}
    assert score(two, method, None, {}) == pytest.approx(expected, abs=0.02)  # files have two digits


def test_a_whole_film_is_scored_as_a_run_of_the_application(street: TrueFilm, tmp_path: Path) -> None:
    job = BackgroundJob(
        street.source, out=tmp_path, engine="coordinate-ascent", ground_truth=street.folder, masks="none"
    )
    pixels = run_background(job).summary["metrics"]["pixels"]
    found = score(street, WHOLE, None, {})
    assert found == pytest.approx({name: pixels[name] for name in found})


@pytest.mark.parametrize("method", [FEEDBACK, WHOLE, *SUBTRACTORS, DETECTED])
def test_every_method_sees_the_noise_of_a_seed(
    street: TrueFilm, two: TrueFilm, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames behind the last mask are not read, but for a film that is taken as a whole."""
    seen = []

    def noticed(frame: Frame, seed: int) -> Frame:
        seen.append((seed, frame.number))
        return frame

    monkeypatch.setattr(experiment, "noisy", noticed)
    film = two if method == DETECTED else street
    plain = score(film, method, None, {})
    assert not seen
    assert score(film, method, 3, {}) == plain
    last = N_FRAMES if method in (DETECTED, WHOLE) else LAST + 1
    assert set(seen) == {(3, number) for number in range(1, last + 1)}


def test_parameters_are_those_of_our_chains(street: TrueFilm) -> None:
    parameters = {"background": {"prior": 0.05}}
    for method in (FEED_FORWARD, WHOLE):
        assert score(street, method, None, parameters) != score(street, method, None, {})


# --- comparisons --------------------------------------------------------------------------------------------


def enumerated(difference: Sequence[float]) -> float:
    """P of Wilcoxon's test by all signs of the ranks; without zeros and ties."""
    ranks = np.argsort(np.argsort(np.abs(difference))) + 1
    observed = ranks[np.array(difference) > 0].sum()
    sums = np.array([np.dot(signs, ranks) for signs in itertools.product((0, 1), repeat=len(ranks))])
    return float(min(1.0, 2 * min((sums <= observed).mean(), (sums >= observed).mean())))


@settings(max_examples=20)
@given(st.permutations(range(1, 9)), st.lists(st.booleans(), min_size=8, max_size=8))
def test_wilcoxons_p_is_that_of_all_signs(sizes: list[int], signs: list[bool]) -> None:
    difference = [size if sign else -size for size, sign in zip(sizes, signs, strict=True)]
    first, second = np.array([5.0 + each for each in difference]), np.full(8, 5.0)
    n, mean, other, better, worse, p = compare(first, second)
    assert (n, better, worse) == (8, sum(signs), 8 - sum(signs))
    assert (mean, other) == pytest.approx((5 + np.mean(difference), 5))
    assert p == pytest.approx(enumerated(difference))
    assert list(compare(second, first)[3:]) == pytest.approx([worse, better, p])


def test_films_without_a_measure_are_not_compared() -> None:
    first, second = np.array([0.5, np.nan, 0.7, 0.2]), np.array([0.4, 0.9, 0.7, np.nan])
    assert list(compare(first, second)) == pytest.approx([2, 0.6, 0.55, 1, 0, 1])
    same = compare(second, second)
    assert same[:1] + same[3:5] == (3, 0, 0)
    assert np.isnan(same[5])
    nothing = compare(first * np.nan, second)
    assert nothing[0] == 0
    assert np.isnan(nothing[1:3]).all()


def test_tables_have_means_over_seeds_and_films(street: TrueFilm, two: TrueFilm) -> None:
    other = TrueFilm("other", street.folder)
    values = {"street": {FEED_FORWARD: (0.2, 0.4), FEEDBACK: (0.5, 0.7)}, "other": {FEED_FORWARD: (0.3, 0.3)}}
    values["other"][FEEDBACK] = (0.9, 0.9)
    scores = {
        (name, method): [{"F": f, "precision": f, "recall": np.nan} for f in of_seeds]
        for name, methods in values.items()
        for method, of_seeds in methods.items()
    }
    found = summarise([street, other, two], scores, {"two": "no reason"})
    compared, f, _, recall, failed = found.tables
    assert [row[0] for row in compared.rows] == ["F", "precision", "recall"]
    assert f.rows[0] == ["street", "0.300 ± 0.141", "0.600 ± 0.141"]
    assert f.rows[2] == ["mean of 2", pytest.approx(0.3), pytest.approx(0.75)]
    assert len(recall.rows) == 2, "no mean of nothing"
    assert compared.rows[0][:4] == ("F", FEEDBACK, FEED_FORWARD, 2)
    assert compared.rows[0][4:8] == (pytest.approx(0.75), pytest.approx(0.3), 2, 0)
    assert list(failed.rows) == [("two", "no reason")]


# --- the command --------------------------------------------------------------------------------------------


def record(out: Path) -> dict[str, Any]:
    """The tables of a call by caption."""
    return {each["caption"]: each for each in json.loads((out / "results.json").read_text())["tables"]}


def test_the_command_measures_what_is_new_and_passes_over_what_is_broken(
    data: Path, street: TrueFilm, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    films, out = tmp_path / "films", tmp_path / "out"
    shutil.copytree(data, films)
    broken = films / "broken"
    shutil.copytree(street.folder, broken)
    cv2.imwrite(str(broken / "groundtruth" / "gt000007.png"), np.zeros((5, 5), np.uint8))
    assert code_of(films, "--out", out, "--jobs", 2, "--quiet") == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("rsmcm: broken: ")
    tables = record(out)
    row = tables["F of masks."]["rows"][0]
    assert tables["F of masks."]["header"] == ["film", *METHODS]
    assert row == ["street", *(pytest.approx(counted(street, method)["F"]) for method in METHODS)]
    assert [each[0] for each in tables["Films that failed and count nowhere."]["rows"]] == ["broken"]
    assert tables["HOTA of tracks."]["rows"][0][0] == "two"
    for name in ("films-masks.png", "films-tracks.png", "index.html"):
        assert (out / name).stat().st_size > 0

    before = json.loads((out / "measured.json").read_text())
    assert len(before) == len(METHODS) + len(DETECTOR_METHODS)
    shutil.rmtree(broken)
    stamp = (out / "measured.json").stat()
    assert code_of(films, "--out", out, "--quiet") == 0
    assert (out / "measured.json").stat().st_mtime_ns == stamp.st_mtime_ns, "nothing was left to do"
    assert record(out)["F of masks."]["rows"][0] == row

    temporal = films / "dataset" / "baseline" / "street" / "temporalROI.txt"
    temporal.write_text(f"{FIRST} {LAST - 2}")
    assert code_of(films, "--out", out, "--jobs", 2, "--quiet") == 0
    after = json.loads((out / "measured.json").read_text())
    assert before.items() <= after.items()
    assert {(each["film"], each["method"]) for key, each in after.items() if key not in before} == {
        ("street", method) for method in METHODS
    }
    assert record(out)["F of masks."]["rows"][0] != row

    (out / "measured.json").write_text('{"x": 3}')
    assert code_of(films, "--out", out) == 2
    assert "measured.json: got TypeError" in capfd.readouterr().err


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_measured(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("reproduce", "films", data, "--out", out, "--seeds", 6, "--jobs", 1)
    process = start(*arguments)
    wait_until((out / "measured.json").exists)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate()
    assert process.returncode == 130
    assert error.endswith("rsmcm: interrupted\n")
    kept = json.loads((out / "measured.json").read_text())
    again = start(*arguments)
    again.communicate()
    assert again.returncode == 0
    whole = json.loads((out / "measured.json").read_text())
    assert kept.items() < whole.items()
    assert len(whole) == 6 * (len(METHODS) + 2) + 2
    assert "±" in record(out)["F of masks."]["rows"][0][1]
