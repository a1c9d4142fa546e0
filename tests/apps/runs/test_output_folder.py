"""The folder of results: one run at a time, and only what a run wrote is removed."""

import json
import multiprocessing
from pathlib import Path

import pytest
from rsmcm.apps.runs.output_folder import MANIFEST, output_folder

from ...conftest import names

FILES = ("a.txt", "masks/bin[0-9]*.png")


def run(path: Path, *written: str, **how: bool) -> None:
    with output_folder(path, "test", **how) as folder:
        folder.begin(FILES, resume=how.get("resume", False))
        for name in written:
            (path / name).parent.mkdir(exist_ok=True)
            (path / name).write_text("result")


def listed(path: Path) -> list[str]:
    files: list[str] = json.loads((path / MANIFEST).read_text())["files"]
    return files


def test_only_what_a_run_wrote_is_removed(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    run(out, "a.txt", "masks/bin000001.png")
    assert listed(out) == sorted(FILES)
    for name in ("mine.txt", "masks/bin_mine.png"):
        (out / name).write_text("the user's")
    with pytest.raises(FileExistsError, match="already holds results: use --overwrite or --resume"):
        run(out)
    run(out, "a.txt", overwrite=True)
    assert names(out) == {"a.txt", "mine.txt", "masks", MANIFEST}
    assert names(out / "masks") == {"bin_mine.png"}
    assert listed(out) == ["a.txt"], "nothing else was written"


def test_a_file_of_the_same_name_that_is_no_result(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("the user's")
    for how in ({}, {"overwrite": True}):
        with pytest.raises(FileExistsError, match=r"holds a\.txt, which no run has written: move it"):
            run(tmp_path, **how)
    assert (tmp_path / "a.txt").read_text() == "the user's"
    assert names(tmp_path) == {"a.txt"}


def test_what_a_kill_left_over_goes(tmp_path: Path) -> None:
    for folder in ("masks", "other"):
        (tmp_path / folder).mkdir()
    left = (".unfinished-9-a.txt", "masks/.unfinished-9-bin000001.png", ".unfinished-9-state.npz")
    for name in (*left, "other/.unfinished-x"):
        (tmp_path / name).write_text("half")
    run(tmp_path)
    assert names(tmp_path) == {"masks", "other"}
    assert names(tmp_path / "masks") == set()
    assert names(tmp_path / "other") == {".unfinished-x"}, "another run may write there now"


def test_nothing_is_left_of_a_run_that_does_not_begin(tmp_path: Path) -> None:
    with output_folder(tmp_path / "new" / "out", "test"):
        pass
    assert names(tmp_path) == set()


def test_resuming_what_is_something_else(tmp_path: Path) -> None:
    run(tmp_path, "a.txt")
    with pytest.raises(ValueError, match=r"state\.npz does not exist, start again with --overwrite"):
        run(tmp_path, resume=True)
    with (
        pytest.raises(ValueError, match=r"--resume: .* holds results of rsmcm test, expected rsmcm face"),
        output_folder(tmp_path, "face", resume=True),
    ):
        pass


@pytest.mark.parametrize(
    "manifest",
    [
        "",
        "[]",
        '{"application": "x", "files": ["../a"]}',
        '{"application": "x", "files": ["/etc/x"]}',
        "[" * 9999,
    ],
)
def test_a_manifest_that_is_none(tmp_path: Path, manifest: str) -> None:
    (tmp_path / MANIFEST).write_text(manifest)
    with pytest.raises(ValueError, match=r"manifest\.json: got no list of a run's files"):
        run(tmp_path, overwrite=True)


def hold(path: Path, held: "multiprocessing.Queue[int]", release: "multiprocessing.Queue[int]") -> None:
    with output_folder(path, "test") as folder:
        folder.begin(FILES)
        held.put(multiprocessing.current_process().pid or 0)
        release.get()


def test_two_runs_at_once(tmp_path: Path) -> None:
    """The second one is told who is there, and harms nothing; after a kill the folder is free."""
    context = multiprocessing.get_context("spawn")
    held, release = context.Queue(), context.Queue()
    process = context.Process(target=hold, args=(tmp_path, held, release))
    process.start()
    number = held.get(timeout=60)
    for how in ({}, {"overwrite": True}, {"resume": True}):
        with pytest.raises(BlockingIOError, match=f"process {number} on .*, since .*, writes there"):
            run(tmp_path, **how)
    process.kill()
    process.join()
    run(tmp_path, overwrite=True)
