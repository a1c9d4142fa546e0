"""`rsmcm shape`, as a user runs it: from a track file to a model, and with what can be wrong about it."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.reproduce import run_experiment, shapes
from rsmcm.apps.io.datasets import data_folder
from rsmcm.inference.nonrigid.learning import learn_shape
from rsmcm.models.face.model_files import read_model

from ...conftest import Command
from ...support.deforming import N_BASES, N_POINTS, deforming, holes

run = Command("shape")
complaint = run.complaint

Numbers = NDArray[np.float64]


@pytest.fixture
def tracks() -> Numbers:
    return holes(deforming(n_frames=15)[0], 0.1)


def test_model_is_written_and_errors_are_reported(
    tmp_path: Path, tracks: Numbers, capfd: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "tracks.npz", tmp_path / "new" / "model.npz"
    tracks[4] = np.nan
    np.savez(source, tracks=tracks, other=np.zeros(3))
    assert run(source, "--bases", N_BASES, "--out", out) == 0
    printed = capfd.readouterr().out
    model = read_model(out)
    learned = learn_shape(tracks, N_BASES)
    assert model.bases.tobytes() == learned.bases.tobytes()
    assert (model.triangles == learned.model().triangles).all()
    assert f"15 frames, {N_POINTS} points, {N_BASES} bases" in printed
    assert f"reprojection error {learned.rmse:.3g} px, {learned.relative_error:.2%}" in printed
    assert f"noise {learned.noise:.3g} px" in printed
    assert f"log likelihood {learned.log_likelihood:.6g}" in printed
    assert "1 frames show too few points" in printed
    assert str(out) in printed


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_files_of_a_single_array(tmp_path: Path, tracks: Numbers, suffix: str) -> None:
    source, out = tmp_path / f"landmarks{suffix}", tmp_path / "model.npz"
    if suffix == ".npy":
        np.save(source, tracks.astype(np.float32))
    else:
        np.savez(source, landmarks=tracks)
    assert run(source, "--bases", 2, "--out", out) == 0
    assert read_model(out).n_bases == 2


def test_a_model_is_replaced_only_if_wanted(
    tmp_path: Path, tracks: Numbers, capfd: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "tracks.npy", tmp_path / "model.npz"
    np.save(source, tracks)
    out.write_bytes(b"mine")
    assert "--overwrite" in complaint(capfd, source, "--bases", 2, "--out", out)
    assert out.read_bytes() == b"mine"
    assert run(source, "--bases", 2, "--out", out, "--overwrite") == 0
    assert read_model(out).n_bases == 2


def test_what_can_be_wrong(tmp_path: Path, tracks: Numbers, capfd: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "tracks.npy", tmp_path / "model.npz"
    ending = ("--bases", 2, "--out", out)
    assert str(source) in complaint(capfd, source, *ending)
    source.write_bytes(b"no array")
    assert f"{source}: got neither .npy nor .npz" in complaint(capfd, source, *ending)
    source.write_bytes(b"")
    assert f"{source}: got neither" in complaint(capfd, source, *ending)
    np.save(source, np.array([{}]), allow_pickle=True)
    assert f"{source}: got array of objects" in complaint(capfd, source, *ending)
    for wrong in (np.zeros((4, 5)), np.zeros((4, 5, 2), complex), np.zeros((4, 5, 2), bool)):
        np.save(source, wrong)
        assert f"{source}: got {wrong.shape} {wrong.dtype}" in complaint(capfd, source, *ending)
    several = tmp_path / "several.npz"
    np.savez(several, a=tracks, b=tracks)
    assert "got arrays 'a', 'b', expected 'tracks'" in complaint(capfd, several, *ending)
    several.write_bytes(several.read_bytes()[:1000])
    assert f"{several}: got" in complaint(capfd, several, *ending)
    np.save(source, tracks)
    assert f"{source}: bases: got 1" in complaint(capfd, source, "--bases", 1, "--out", out)
    assert f"{source}: bases: got 99" in complaint(capfd, source, "--bases", 99, "--out", out)
    assert ".npz" in complaint(capfd, source, "--bases", 2, "--out", tmp_path / "model.obj")
    tracks[:, 3] = np.nan
    np.save(source, tracks)
    assert f"{source}: tracks: got point 3 in 0 frames" in complaint(capfd, source, *ending)
    tracks[2, 3] = np.inf
    np.save(source, tracks)
    assert "point 3 of frame 2" in complaint(capfd, source, *ending)
    assert not out.exists()


# --- against the truth --------------------------------------------------------------------------------------


def test_measures_of_error() -> None:
    truth = deforming()[1]
    random = np.random.default_rng(0)
    turned = shapes.centred(truth) @ np.linalg.qr(random.standard_normal((3, 3)))[0]
    assert shapes.normalised_error(shapes.turned_onto(turned, truth), truth) < 1e-12
    mirrored = truth * [1, 1, -1] + [5, 6, 7]
    assert shapes.normalised_error(shapes.nearer_image(mirrored, truth), truth) < 1e-12
    longer = truth.mean(axis=1, keepdims=True) + 1.25 * shapes.centred(truth)
    assert shapes.normalised_error(longer, truth) == pytest.approx(0.25)


def test_tables_and_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shapes, "data_folder", lambda name: tmp_path)
    monkeypatch.setattr(shapes, "read_truth", lambda path: deforming(n_frames=20)[1])
    monkeypatch.setattr(shapes, "BASES", {"face": N_BASES})
    monkeypatch.setattr(shapes, "MISSING", (0.0, 0.2))
    run_experiment("shapes", tmp_path / "out")
    printed = capsys.readouterr().out
    assert "face, 20% missing: 3-D error" in printed
    assert (tmp_path / "out" / "index.html").read_text().count("<svg") == 2


def test_truth_files(tmp_path: Path) -> None:
    from scipy.io import savemat

    truth = deforming(n_frames=5)[1]
    savemat(tmp_path / "a.mat", {"P3_gt": np.concatenate([truth[..., axis] for axis in range(3)])})
    assert (shapes.read_truth(tmp_path / "a.mat") == truth).all()
    savemat(tmp_path / "b.mat", {"P3_gt": np.zeros((4, 5))})
    with pytest.raises(ValueError, match=r"got \(4, 5\), expected 'P3_gt'"):
        shapes.read_truth(tmp_path / "b.mat")


@pytest.mark.parametrize("name", sorted(shapes.BASES))
@pytest.mark.slow
def test_public_sequences(name: str) -> None:
    try:
        folder = data_folder("nrsfm-torresani")
    except OSError as missing:
        pytest.skip(str(missing))
    truth = shapes.read_truth(folder / f"{name}.mat")
    learned = learn_shape(shapes.withheld(truth[..., :2], 0.2, np.random.default_rng(0)), shapes.BASES[name])
    assert shapes.Outcome(name, 0.2, learned, truth).error < shapes.PUBLISHED[name]
