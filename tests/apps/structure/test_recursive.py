"""`rsmcm structure --engine recursive-bp`: a film frame by frame, and what it is not for."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rsmcm.apps.scenes import cylinder
from rsmcm.apps.view.film import read_film
from rsmcm.chains import PointTracker, RecursiveStructure
from rsmcm.chains.reconstruction import recursive_reconstruction
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.inference.sfm.affine_camera import affine_alignment
from rsmcm.models import PointTracks, frames_of_tracks

from ...conftest import Command, names, summary_of
from ...support.reconstructions import write_film

run = Command("structure")
complaint = run.complaint
RECURSIVE = ("--engine", "recursive-bp")


def test_a_turning_thing_has_a_shape_while_frames_come_in(tmp_path: Path) -> None:
    film, out = tmp_path / "film", tmp_path / "out"
    film.mkdir()
    write_film(film, n_frames=24)
    assert run(film, "--out", out, *RECURSIVE) == 0
    assert names(out) >= {"structure.ply", "cameras.json", "tracks.npz", "summary.json", "view.html"}
    summary = summary_of(out)
    assert summary["shape"] in {"affine", "euclidean"}
    assert summary["points"] >= 10
    assert summary["reprojection_rmse_px_per_point"] < 1
    with np.load(out / "tracks.npz") as tracks:
        since = summary["shape_since_frame"] - 1
        assert np.isfinite(tracks["position"][since:]).all()
        assert np.isnan(tracks["position"][:since]).all()
        assert tracks["observed"][since:].any(axis=0).mean() > 0.9
    assert read_film(out).columns["id"].min() == 1


def test_a_scene_that_stands_still_has_none(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    film, out = tmp_path / "film", tmp_path / "out"
    film.mkdir()
    picture = np.random.default_rng(0).integers(0, 256, (80, 100), np.uint8)
    for number in range(1, 5):
        cv2.imwrite(str(film / f"frame{number}.png"), picture)
    assert run(film, "--out", out, *RECURSIVE) == 1
    assert summary_of(out)["diagnosis"]["missing"] in capfd.readouterr().err
    assert "structure.ply" not in names(out)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ("--live", "0"),
            "--live and --engine coordinate-ascent: got both, expected one of them "
            "(the second, which is the default, takes all frames together)",
        ),
        ((*RECURSIVE, "--camera", "affine"), "--camera affine and --engine recursive-bp: got both"),
        (RECURSIVE, "expected a film or a stream"),
    ],
)
def test_what_it_is_not_for(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], options: tuple[str, ...], said: str
) -> None:
    source = tmp_path / "tracks.npy"
    np.save(source, np.zeros((4, 5, 2)))
    assert said in complaint(capfd, source, "--out", tmp_path / "out", *options)


def test_the_last_shape_and_its_cameras_are_read_from_the_filter() -> None:
    turning = cylinder(n_points=25, n_frames=60, p_loose=0.02, p_drift=0.0, seed=3, degrees_per_frame=4)
    points = PointTracks(noise=0.01)
    model = MultiChain().connect(PointTracker(), points).connect(RecursiveStructure(), points)
    cameras, spreads = np.full((60, 2, 4), np.nan), np.full((60, 4, 4), np.nan)
    for index, belief in enumerate(RecursiveBP(model).run(frames_of_tracks(turning.observed))):
        structure = belief["structure"].structure
        if structure is not None:
            cameras[index] = structure.motion.camera
            spreads[index] = structure.motion.camera_covariance
    assert structure is not None
    found = recursive_reconstruction(structure, cameras, spreads, turning.observed[:, structure.identities])
    assert found.determined[-1]
    assert not found.determined[0]
    truth = turning.shape[structure.identities]
    assert affine_alignment(found.shape, truth).error < 0.1
    off = found.positions[-1] - turning.positions[-1, structure.identities]
    assert np.median(np.linalg.norm(off, axis=1)) < 0.05
