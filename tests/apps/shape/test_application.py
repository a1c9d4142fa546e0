"""`rsmcm shape`, as a user runs it: from tracks to a folder of results, and what can be wrong about them."""

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.shape import application as module
from rsmcm.inference.sfm.nonrigid.learning import learn_shape
from rsmcm.inference.sfm.nonrigid.shape import Rival, shape_error
from rsmcm.models.face.model_files import read_model

from ...conftest import Command, names, summary_of, without_compiling
from ...support.browser import browsing
from ...support.deforming import N_BASES, N_POINTS, deforming, holes
from ...support.view_page import shown_page

run = Command("shape")
complaint = run.complaint

Numbers = NDArray[np.float64]

ALWAYS = {"shapes.npz", "model.npz", "summary.json", "view.html", "manifest.json"}
N_FRAMES, UNKNOWN = 15, 4


@pytest.fixture(scope="module")
def truth() -> Numbers:
    return deforming(n_frames=N_FRAMES)[1]


@pytest.fixture(scope="module")
def tracks() -> Numbers:
    partial = holes(deforming(n_frames=N_FRAMES)[0], 0.1)
    partial[UNKNOWN] = np.nan
    return partial


@pytest.fixture(scope="module")
def source(tracks: Numbers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tracks") / "tracks.npz"
    np.savez(path, tracks=tracks, other=np.zeros(3))
    return path


@pytest.fixture(scope="module")
def finished(source: Path, truth: Numbers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    np.savez(folder / "truth.npz", shapes=truth)
    arguments = ("--bases", N_BASES, "--truth", folder / "truth.npz", "--out", folder / "out")
    assert run(source, *arguments) == 0
    return folder / "out"


# --- what a run leaves --------------------------------------------------------------------------------------


def test_smooth_is_what_the_command_asks_for(
    source: Path, tracks: Numbers, finished: Path, tmp_path: Path
) -> None:
    assert run(source, "--bases", N_BASES, "--smooth", "--out", tmp_path / "out") == 0
    with np.load(tmp_path / "out" / "shapes.npz") as smooth, np.load(finished / "shapes.npz") as rough:
        expected = learn_shape(tracks, N_BASES, smooth=True).shapes()
        np.testing.assert_array_equal(smooth["shapes"], expected)
        assert not np.allclose(smooth["shapes"], rough["shapes"], equal_nan=True)


def test_files_and_what_is_said(source: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "out"
    assert run(source, "--bases", N_BASES, "--out", out) == 0
    assert names(out) == ALWAYS
    printed, summary = capfd.readouterr().out, summary_of(out)
    point, coordinate = (summary[f"reprojection_rmse_px_per_{each}"] for each in ("point", "coordinate"))
    assert f"{N_FRAMES} frames, {N_POINTS} points, {N_BASES} bases" in printed
    assert f"reprojection error {point:.3g} px per point, {coordinate:.3g} px per coordinate" in printed
    assert f"noise {summary['noise_px_per_coordinate']:.3g} px per coordinate" in printed
    assert f"log likelihood {summary['log_likelihood']:.6g}" in printed
    assert "1 frame shows too few points for a pose: 5." in printed
    assert f"results: {out / 'view.html'}" in printed
    assert summary["e3d"] is summary["held_out"] is None
    assert summary["parameters"]["bases"] == N_BASES


def test_shapes_are_those_that_were_learned(finished: Path, tracks: Numbers) -> None:
    learned = learn_shape(tracks, N_BASES)
    with np.load(finished / "shapes.npz") as content:
        found = dict(content)
    np.testing.assert_array_equal(found["shapes"], learned.shapes())
    np.testing.assert_array_equal(found["covariance"], learned.shape_covariances())
    model = read_model(finished / "model.npz")
    assert model.bases.tobytes() == learned.bases.tobytes() == found["bases"].tobytes()
    assert (model.triangles == learned.model().triangles).all()
    assert found["frame"].tolist() == list(range(1, N_FRAMES + 1))
    np.testing.assert_array_equal(found["observed"], ~np.isnan(tracks[..., 0]))


def test_shapes_follow_from_their_parts_as_is_written(finished: Path, tracks: Numbers) -> None:
    """`docs/files.md`; errors in the summary are those of the tracks."""
    with np.load(finished / "shapes.npz") as content:
        found = dict(content)
    mixed = found["bases"][0] + np.tensordot(found["weights"], found["bases"][1:], 1)
    mixed += np.tensordot(found["detail_weights"], found["details"], 1)
    places = found["scales"][:, None, None] * mixed @ found["rotations"].transpose(0, 2, 1)
    places[..., :2] += found["translations"][:, None]
    np.testing.assert_allclose(found["shapes"], places, atol=1e-9)
    known = np.arange(N_FRAMES) != UNKNOWN
    assert np.isfinite(found["shapes"][known]).all()
    assert np.isnan(found["shapes"][UNKNOWN]).all()
    assert (np.linalg.eigvalsh(found["covariance"][known]) > 0).all()
    summary, off = summary_of(finished), tracks - found["shapes"][..., :2]
    assert summary["reprojection_rmse_px_per_coordinate"] == pytest.approx(np.sqrt(np.nanmean(off**2)))
    distances = np.square(off).sum(axis=2)
    assert summary["reprojection_rmse_px_per_point"] == pytest.approx(np.sqrt(np.nanmean(distances)))


def test_error_in_space(finished: Path, truth: Numbers) -> None:
    with np.load(finished / "shapes.npz") as content:
        expected = shape_error(content["shapes"], truth)
    assert summary_of(finished)["e3d"] == pytest.approx(expected)
    assert f"{expected:.4f}" in (finished / "view.html").read_text()


def test_number_of_bases_by_what_was_held_out(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "tracks.npy", deforming(n_frames=20)[0][:, :12])
    assert run(tmp_path / "tracks.npy", "--bases", "auto", "--out", tmp_path / "out") == 0
    summary = summary_of(tmp_path / "out")
    tried = {each["bases"]: each["error_px_per_coordinate"] for each in summary["held_out"]}
    assert list(tried) == [2, 3]
    assert summary["bases"] in tried
    assert f"{summary['bases']} bases: the fewest that predict held-out positions" in capfd.readouterr().out
    assert "Number of bases" in (tmp_path / "out" / "view.html").read_text()


def test_points_that_stand_still_are_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    random = np.random.default_rng(0)
    still = random.uniform(20, 140, (1, 12, 2)) + 0.3 * random.normal(size=(10, 12, 2))
    np.save(tmp_path / "still.npy", still)
    assert run(tmp_path / "still.npy", "--out", tmp_path / "out", "--bases", 2) == 0
    assert "Nothing moves but for noise" in capfd.readouterr().out


def test_rivals_are_said(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    def with_rivals(*arguments: Any, **more: Any) -> Any:
        return replace(learn_shape(*arguments, **more), rivals=(Rival(2.5, 0.31), Rival(7.0, 0.64)))

    monkeypatch.setattr(module, "learn_shape", with_rivals)
    assert run(source, "--bases", 2, "--out", tmp_path) == 0
    assert "2 other shapes explain the tracks nearly as well (2.5 nats less)" in capfd.readouterr().out
    assert summary_of(tmp_path)["rivals"][1] == {"log_likelihood_gap": 7.0, "disagreement": 0.64}
    assert "up to 64% of the shape" in (tmp_path / "view.html").read_text()


# --- pages --------------------------------------------------------------------------------------------------


def test_the_page_turns_and_deforms(finished: Path) -> None:
    with np.load(finished / "shapes.npz") as content:
        shapes, covariance, observed = content["shapes"], content["covariance"], content["observed"]
    with browsing() as browser, shown_page(browser, finished, (1, 1)) as shown:
        index, point = np.argwhere(~observed)[0].tolist()
        shown.page.locator(f"#row-{point} .label").click()
        shown.show(index)
        assert shown.details["now"] == "not seen, by shape and pose"
        np.testing.assert_allclose(shown.numbers("place"), shapes[index, point, :2], atol=0.06)
        spread = np.sqrt(np.diag(covariance[index, point]))[:2]
        np.testing.assert_allclose(shown.numbers("unsure by"), spread, atol=0.006)
        before = shown.inked(".space")
        shown.show(8)
        assert shown.inked(".space") != before
        which = shown.page.get_by_label("Which shape")
        which.select_option("mode 1")
        high = shown.inked(".space")
        shown.page.get_by_label("Weight of the mode").fill("-2")
        assert shown.inked(".space") != high
        shown.page.get_by_label("as a surface").check()
        surface = shown.inked(".space")
        shown.page.locator(".space").focus()
        shown.page.keyboard.press("ArrowLeft")
        assert shown.inked(".space") != surface
        shown.show(UNKNOWN)
        assert "place" not in shown.details


# --- what can be wrong --------------------------------------------------------------------------------------


def test_results_are_replaced_only_if_wanted(
    source: Path, finished: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "model.npz").write_bytes(b"mine")
    for more in ((), ("--overwrite",)):
        message = complaint(capfd, source, "--bases", 2, "--out", tmp_path, *more)
        assert "model.npz, which no run has written" in message
    before = (finished / "model.npz").read_bytes()
    assert "--overwrite" in complaint(capfd, source, "--bases", 2, "--out", finished)
    assert "unknown option --resume" in complaint(capfd, source, "--bases", 2, "--out", finished, "--resume")
    assert (finished / "model.npz").read_bytes() == before


def test_what_can_be_wrong(tmp_path: Path, tracks: Numbers, capfd: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "tracks.npy", tmp_path / "out"
    ending = ("--bases", 2, "--out", out)
    assert str(source) in complaint(capfd, source, *ending)
    source.write_bytes(b"no array")
    assert f"{source}: got neither" in complaint(capfd, source, *ending)
    np.save(source, tracks)
    assert f"{source}: bases: got 1" in complaint(capfd, source, "--bases", 1, "--out", out)
    assert f"{source}: bases: got 99" in complaint(capfd, source, "--bases", 99, "--out", out)
    message = complaint(capfd, source, "--bases", "many", "--out", out)
    assert "--bases: got 'many', expected a whole number or auto" in message
    assert "expected 15 or more frames of 20 points" in complaint(
        capfd, source, *ending, "--truth", truth_file(tmp_path, np.zeros((14, N_POINTS, 3)))
    )
    assert "expected (n_frames, n_points, 3)" in complaint(
        capfd, source, *ending, "--truth", truth_file(tmp_path, np.zeros((15, N_POINTS, 2)))
    )
    assert "not finite" in complaint(
        capfd, source, *ending, "--truth", truth_file(tmp_path, np.full((15, N_POINTS, 3), np.nan))
    )
    never = tracks.copy()
    never[:, 3] = np.nan
    np.save(source, never)
    assert f"{source}: tracks: got point 3 in 0 frames" in complaint(capfd, source, *ending)
    assert not out.exists()


def truth_file(folder: Path, shapes: Numbers) -> Path:
    np.save(folder / "truth.npy", shapes)
    return folder / "truth.npy"


def test_control_c(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """While it learns, nothing is left; later everything is."""

    def interrupted(*arguments: Any, **more: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return learn_shape(*arguments, **more)

    with monkeypatch.context() as patch:
        patch.setattr(module, "learn_shape", interrupted)
        assert run(source, "--bases", 2, "--out", tmp_path / "out") == 130
    assert not (tmp_path / "out").exists()
    assert without_compiling(capfd.readouterr().err) == "rsmcm: interrupted before there was any result\n"

    def writing(*arguments: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        write_page(*arguments)

    write_page = module.write_page
    monkeypatch.setattr(module, "write_page", writing)
    assert run(source, "--bases", 2, "--out", tmp_path / "out") == 130
    assert names(tmp_path / "out") == ALWAYS
    json.loads((tmp_path / "out" / "summary.json").read_text())
