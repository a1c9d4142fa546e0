"""Batches as they are typed: results of single runs, failures that stop nobody, kills, printed commands."""

import csv
import json
import os
import shlex
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from rsmcm.apps.batch import application
from rsmcm.apps.batch.application import run_batch, workers_for
from rsmcm.apps.batch.job import Batch, job_of, options_of
from rsmcm.apps.batch.sources import FilmSource
from rsmcm.apps.batch.summary import FilmStatus
from rsmcm.apps.command_line import main
from rsmcm.apps.runs import saved_run
from rsmcm.models.numerics.threads import set_threads, thread_count

from ...support.films import (
    COMMAND,
    results,
    stamps,
    start,
    wait_until,
    write_film,
    write_films,
    write_long_films,
)


def rows(out: Path) -> dict[str, dict[str, str]]:
    """Lines of the summary by folder."""
    with (out / "summary.csv").open(newline="") as file:
        return {row["folder"]: row for row in csv.DictReader(file)}


def code_of(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["batch", "background", *map(str, arguments)])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_films(tmp_path_factory.mktemp("films") / "films", 3, 12)


@pytest.fixture(scope="module")
def done(films: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A batch over these films."""
    out = tmp_path_factory.mktemp("done") / "out"
    assert code_of(films, "--out", out, "--jobs", 2, "--seed", "3", "--quiet") == 0
    return out


def test_results_are_those_of_single_runs(films: Path, done: Path, tmp_path: Path) -> None:
    for film in films.iterdir():
        with pytest.raises(SystemExit):
            main(["background", str(film), "--out", str(tmp_path / film.name), "--seed", "3", "--quiet"])
        assert results(done / film.name) == results(tmp_path / film.name)
    assert {row["state"] for row in rows(done).values()} == {"complete"}
    assert [row["frames"] for row in rows(done).values()] == ["12"] * 3
    page = (done / "index.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 3
    assert 'href="film000/view.html"' in page


def test_what_is_complete_is_left_as_it_is(
    films: Path, done: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = {path: each for path, each in stamps(done).items() if path.parent != done}
    assert code_of(films, "--out", done, "--seed", "3") == 0
    assert {path: each for path, each in stamps(done).items() if path.parent != done} == before
    assert capfd.readouterr().out == f"3 videos: 3 complete\nresults: {done / 'index.html'}\n"
    assert (done / "index.html").read_text().count("data:image/jpeg;base64,") == 3


def test_killed_behind_its_last_state(films: Path, done: Path, tmp_path: Path) -> None:
    """What such a run had no time to remove is removed by the next batch."""
    out = shutil.copytree(done, tmp_path / "out")
    folder = out / "film001"
    (folder / "film.part000000012.mp4").write_bytes(b"")
    (folder / ".running.json").write_text("{}")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"].append("film.part*.mp4")
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert code_of(films, "--out", out, "--seed", "3") == 0
    assert results(folder).keys() == results(done / "film001").keys()
    assert not (folder / ".running.json").exists()


def test_other_options_are_not_mixed(films: Path, done: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = results(done / "film001")
    assert code_of(films, "--out", done) == 1
    _, err = capfd.readouterr()
    lines = [line for line in err.splitlines() if line.startswith("rsmcm: ")]  # progress has others
    assert len(lines) == 3
    assert lines[1] == (
        f"rsmcm: {films / 'film001'}: other parameters than in the saved run: seed was 3, now 0: "
        "--overwrite begins anew"
    )
    assert results(done / "film001") == before
    assert code_of(films, "--out", done, "--seed", "3") == 0


@pytest.mark.parametrize("forged", [{"frames": "12"}, {"frames_per_second": {}}, {"missing": 3}])
def test_a_summary_with_forged_counts(
    films: Path, done: Path, forged: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    def about_of(*given: Any) -> dict[str, Any]:
        about = saved_run.about_of(*given)
        return {**about, "finished": {**about["finished"], **forged}}

    monkeypatch.setattr(application, "about_of", about_of)
    film = "film001"
    job = job_of("background", [str(films / film), "--out", str(done / film), "--seed", "3"])
    status = application.run_film("background", job)
    assert (status.state, status.frames) == ("failed", None)
    assert status.error.endswith("got another summary, expected a state that was saved here")


def test_a_failure_stops_nobody(films: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "films"
    shutil.copytree(films, broken)
    (broken / "broken.mp4").write_bytes(b"no film")
    assert code_of(broken, "--out", tmp_path / "out", "--jobs", 2) == 1
    out, err = capfd.readouterr()
    assert out.splitlines()[0] == "4 videos: 3 complete, 1 failed"
    source = broken / "broken.mp4"
    assert err.splitlines()[-1].startswith(f"rsmcm: {source}: not a video that can be read")
    assert rows(tmp_path / "out")["broken"]["state"] == "failed"
    assert not (tmp_path / "out" / "broken").exists()
    (broken / "broken.mp4").unlink()
    write_film(broken / "broken.mp4", 6)
    assert code_of(broken, "--out", tmp_path / "out", "--jobs", 2) == 0


def test_what_is_wrong_with_the_command_begins_nothing(
    films: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    (tmp_path / "list.toml").write_text("[[camera]]\nsource = '0'\nfrobnicate = 3\n")
    (tmp_path / "cameras.toml").write_text("[[camera]]\nsource = '0'\n[[camera]]\nsource = 'rtsp://host/a'\n")
    for arguments, words in (
        ([films, films / "nothing"], "nothing: no such file or folder"),
        ([films, "--warm-up", "-1"], "--warm-up: got -1, expected seconds"),
        ([tmp_path / "list.toml"], "list.toml, camera 1: unknown option --frobnicate"),
        ([tmp_path / "cameras.toml", "--jobs", 1], "--jobs: got 1, expected 2 or more: all live cameras"),
        ([films, "--jobs", 0], "--jobs: got 0, expected 1 or more"),
        ([films, "--jobs", 1, "--dask", "x"], "--jobs and --dask: got both"),
        (
            [films, "--dask", "nothing://there"],
            "--dask: got nothing://there, expected the address of a sched",
        ),
        ([], "SOURCES is needed"),
    ):
        assert code_of(*arguments, "--out", out) == 2
        err = capfd.readouterr().err
        assert words in err
        assert err.count("\n") == 1
        assert not list(out.glob("*/*"))
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "summary.csv").write_text("mine\n")
    assert code_of(films, "--out", foreign) == 2
    assert "summary.csv: no batch has written it" in capfd.readouterr().err
    assert (foreign / "summary.csv").read_text() == "mine\n"


def test_threads_and_jobs() -> None:
    cores = os.cpu_count() or 1
    before = thread_count()
    try:
        set_threads(8)
        for jobs in range(1, cores + 2):
            workers = workers_for([FilmSource("film.mp4")], Batch(out=Path("out"), jobs=jobs))
            assert workers.jobs == jobs
            assert workers.threads == 1 or workers.jobs * workers.threads <= cores
    finally:
        set_threads(before)
    cameras = [FilmSource(str(number)) for number in range(cores + 3)]
    assert workers_for(cameras, Batch(out=Path("out"))).jobs == cores + 3


@pytest.mark.slow
def test_printed_commands_do_the_same(films: Path, done: Path, tmp_path: Path) -> None:
    """In a shell, from elsewhere; the batch afterwards only writes summary and page."""
    spaced = tmp_path / "my films; $HOME 'x'"
    shutil.copytree(films, spaced)
    out = tmp_path / "out"
    batch = ["batch", "background", str(spaced), "--out", str(out), "--seed", "3"]
    printed, same = (
        subprocess.run([*COMMAND, *batch, only], check=True, capture_output=True, text=True).stdout
        for only in ("--print", "--dry-run")
    )
    assert same == printed
    assert not out.exists()
    for line in printed.splitlines():
        assert line.startswith("rsmcm background ")
        command = line.replace("rsmcm", shlex.join(COMMAND), 1)
        subprocess.run(command, shell=True, check=True, cwd=tmp_path, capture_output=True)
    before = stamps(out)
    for film in films.iterdir():
        assert results(out / film.name) == results(done / film.name)
    subprocess.run([*COMMAND, *batch], check=True, capture_output=True)
    assert before.items() <= stamps(out).items()
    assert {row["state"] for row in rows(out).values()} == {"complete"}


@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.slow)])
def test_killed_in_the_middle(count: int, tmp_path: Path) -> None:
    """Run again, nothing is done twice, and nothing is missing."""
    films, out = write_films(tmp_path / "films", count), tmp_path / "out"
    arguments = ("batch", "background", films, "--out", out, "--jobs", 2, "--every", 2)
    process = start(*arguments)

    def complete_folders() -> list[Path]:
        return [
            path.parent for path in out.glob("*/summary.json") if not (path.parent / ".running.json").exists()
        ]

    wait_until(lambda: len(complete_folders()) >= count // 3)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert len(rows(out)) == count, "known from the beginning"
    complete = complete_folders()
    assert len(complete) < count
    before = {path: each for folder in complete for path, each in stamps(folder).items()}
    again = start(*arguments)
    printed, complaints = again.communicate(timeout=300)
    assert again.returncode == 0, complaints
    assert printed.splitlines()[0] == f"{count} videos: {count} complete"
    assert before.items() <= stamps(out).items()
    whole = tmp_path / "whole"
    assert code_of(films / "film005", "--out", whole, "--quiet", "--every", 2) == 0
    assert results(out / "film005") == results(whole / "film005")


@pytest.mark.slow
def test_control_c(tmp_path: Path) -> None:
    """All that has begun ends with what it has; what waits is not begun; the next batch goes on."""
    films, out = write_long_films(tmp_path / "films", 4, 2000), tmp_path / "out"
    process = start("batch", "background", films, "--out", out, "--jobs", 2, "--masks", "none", "--every", 5)
    # both have answered frames and kept them: before the first one there is nothing to report
    wait_until(lambda: len({part.parent for part in out.glob("*/film.part*")}) == 2)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does it
    printed, complaints = process.communicate(timeout=60)
    assert process.returncode == 130, complaints
    assert printed.splitlines()[0] == "4 videos: 0 complete, 2 interrupted, 2 waiting"
    for folder in sorted(out.glob("film*")):
        assert (folder / "view.html").read_text().endswith("</html>\n")
        assert (folder / "film.mp4").stat().st_size > 0
        assert not (folder / ".running.json").exists()
    process = start("batch", "background", films, "--out", out, "--jobs", 2, "--masks", "none", "--every", 5)
    for _ in ("where it goes on", "after some frames"):
        before = {path: path.stat().st_mtime_ns for path in out.glob("*/state.npz")}
        wait_until(lambda before=before: all(path.stat().st_mtime_ns > before[path] for path in before))
    process.terminate()  # only the parent hears of it
    assert process.wait(60) == 143
    assert int(rows(out)["film000"]["frames"]) > 5


def dies(_: str, job: object) -> FilmStatus:
    """In place of `run_film`: the process of one film is killed, as the system does where memory ends."""
    folder = job.out  # type: ignore[attr-defined]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "begun").open("a").write("x")
    if folder.name == "film001":
        (folder / ".running.json").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return FilmStatus("complete")


@pytest.mark.slow
def test_whoever_takes_his_process_along_stops_nobody(
    films: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "run_film", dies)
    ended = run_batch("background", [str(films)], Batch(out=tmp_path, jobs=2), options_of("background")())
    states = {line.folder: line.status.state for line in ended.lines}
    assert states == {"film000": "complete", "film001": "failed", "film002": "complete"}
    assert ended.lines[1].status.error == "its process was ended by the system, twice"
    assert (tmp_path / "film001" / "begun").read_text() == "xx"


def test_sources_that_are_shown_as_one_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """They would have one line and one folder."""
    cameras = [f"rtsp://{user}:secret@127.0.0.1/street" for user in ("one", "two")]
    assert code_of(*cameras, "--out", tmp_path / "out") == 2
    said = capfd.readouterr().err
    assert said.startswith("rsmcm: rtsp://127.0.0.1/street: got it twice, expected sources that differ by")
    assert "secret" not in said
    assert not (tmp_path / "out").exists()


def test_one_batch_at_a_time_writes_into_a_folder(
    films: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    with FileLock(tmp_path / "out" / ".lock"):
        assert code_of(films, "--out", tmp_path / "out") == 2
    assert "writes there: wait for it, or choose another folder" in capfd.readouterr().err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {".lock"}
