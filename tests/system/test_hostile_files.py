"""Damaged files as users meet them, by the command line: one line, exit code 2, nothing is left behind."""

import io
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from ..conftest import Command


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    for number in range(1, 6):
        image = np.random.default_rng(number).integers(0, 256, (48, 64, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return folder


def points() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, 40, (6, 8, 2))


def npy() -> bytes:
    stream = io.BytesIO()
    np.save(stream, points())
    return stream.getvalue()


def npz(how: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", how) as archive:
        archive.writestr("tracks.npy", npy())
    return stream.getvalue()


def damaged_header() -> bytes:
    return npy().replace(b"'shape'", b"'shape\x07", 1)


DAMAGED = {
    "header.npy": damaged_header,
    "cut.npy": lambda: npy()[:-5],
    "lzma.npz": lambda: npz(zipfile.ZIP_LZMA),
    "cut.npz": lambda: npz()[:-30],
    "zeros.mat": lambda: bytes(4000),
    "new.mat": lambda: b"MATLAB 7.3 MAT-file" + bytes(500),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_arrays(name: str, film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / name, tmp_path / "out"
    path.write_bytes(DAMAGED[name]())
    for command, arguments in (
        ("structure", (path, "--out", out)),
        ("shape", (path, "--bases", 2, "--out", out)),
        ("face", (film, "--landmarks", path, "--out", out)),
    ):
        assert f"{path}: got " in Command(command).complaint(capfd, *arguments)
    if path.suffix == ".npz":
        message = Command("face").complaint(capfd, film, "--model", path, "--out", out)
        assert f"{path}: got " in message
    assert [each.name for each in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "[" * 5000, "brackets in brackets"),
        ("[background]\nprior = " + "9" * 5000, "not a TOML file"),
        ("[background]\nprior = 1" + "0" * 400, "prior"),
        ("[background]\nprior = nan", "prior"),
        ("# " + "long " * 300_000, "got more than 1048576 bytes"),
        ("[background]\0", "got binary data"),
    ],
)
def test_parameters(
    text: str, words: str, film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    message = Command("background").complaint(capfd, film, "--config", path, "--out", tmp_path / "out")
    assert f"{path}" in message
    assert words in message
    assert not (tmp_path / "out").exists()
