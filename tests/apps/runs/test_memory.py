"""What a run says that it needs in memory is what it takes."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rsmcm.apps.runs import memory
from rsmcm.apps.scenes import face, signer, turntable

from ...conftest import Command, with_peak

SCALES, N_FRAMES = (2, 6), 8
AT_MOST, AT_LEAST = 1.15, 0.4
"""Of what is stated."""


def film(folder: Path, images: list[np.ndarray], scale: int, magnified: bool) -> tuple[Path, int]:
    """A film whose pictures are magnified, or show as much more beside, and its pixels."""
    path = folder / f"film{scale}"
    path.mkdir()
    for number, image in enumerate(images):
        if magnified:
            large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        else:
            beside = (scale - 1) * np.array(image.shape[:2])
            large = cv2.copyMakeBorder(image, 0, beside[0], 0, beside[1], cv2.BORDER_REPLICATE)
        cv2.imwrite(str(path / f"{number}.jpg"), large)
    return path, large.shape[0] * large.shape[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "stated"),
    [
        ("background", (), memory.BACKGROUND["gaussian"]),
        ("background", ("--engine", "coordinate-ascent"), memory.BACKGROUND["gaussian"]),
        ("background", ("--config", "mixture.toml"), memory.BACKGROUND["mixture"]),
        ("structure", ("--stop", N_FRAMES), memory.STRUCTURE + N_FRAMES * memory.STRUCTURE_FRAME),
        ("body", ("--head", "354,74,58,82"), memory.BODY + N_FRAMES * memory.KEPT_IMAGE),
        ("face", ("--landmarks", "landmarks{scale}.npy"), memory.FACE),
    ],
)
def test_bytes_per_pixel(name: str, options: tuple[object, ...], stated: float, tmp_path: Path) -> None:
    (tmp_path / "mixture.toml").write_text('[background]\nmodel = "mixture"\n')
    scene = face(N_FRAMES, light=0.5) if name == "face" else signer(N_FRAMES, 2)
    images = list(turntable(N_FRAMES, (288, 360)).images if name == "structure" else scene.images())
    found = []
    for scale in SCALES:
        path, pixels = film(tmp_path, images, scale, name != "body")  # a small head needs most
        if name == "face":
            np.save(tmp_path / f"landmarks{scale}.npy", (scene.vertices + 0.5) * scale - 0.5)
        filled = [str(option).format(scale=scale) for option in options]
        given = [tmp_path / each if each.endswith((".toml", ".npy")) else each for each in filled]
        for attempt in range(2):  # loops that are compiled need memory too, the first time
            done, peak = with_peak(name, path, "--out", tmp_path / f"out{scale}-{attempt}", *given)
            assert done.returncode == 0, done.stderr
        found.append((pixels, peak))
    (few, less), (many, more) = found
    assert AT_LEAST * stated < (more - less) / (many - few) < AT_MOST * stated


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("background", ()),
        ("structure", ()),
        ("body", ("--head", "354,74,58,82")),
        ("face", ()),
    ],
)
def test_a_run_that_needs_more_than_there_is(
    name: str,
    options: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path, _ = film(tmp_path, list(signer(4, 2).images()), 1, True)
    monkeypatch.setattr(memory.psutil, "virtual_memory", lambda: SimpleNamespace(available=2_000_000))
    message = Command(name).complaint(capfd, path, "--out", tmp_path / "out", *options)
    assert f"{path}: a run on 640x360 px with these settings needs about" in message
    assert "0.002 GB that are available" in message
    assert not (tmp_path / "out").exists()
