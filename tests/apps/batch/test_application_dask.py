"""A batch on a Dask cluster of two workers, one of which is killed in the middle of a film."""

import json
from pathlib import Path

import pytest
from rsmcm.apps.command_line import main

from ...support.cluster import cluster
from ...support.films import results, stamps, start, wait_until, write_films

pytest.importorskip("distributed")
COUNT = 8


def in_work(out: Path, process: int) -> bool:
    """Whether a process has come to the middle of a film."""
    for holder in out.glob("*/.running.json"):
        try:
            held_by = json.loads(holder.read_text())["process"]
        except (OSError, ValueError):  # it ends just now
            continue
        if held_by == process and (holder.parent / "tracks.txt").exists():
            return True
    return False


def ended(out: Path) -> list[Path]:
    """Folders of films that are done."""
    folders = [page.parent for page in out.glob("*/view.html")]
    return [each for each in folders if not (each / ".running.json").exists()]


@pytest.mark.slow
def test_one_worker_is_killed(tmp_path: Path) -> None:
    """All films end, nothing is done twice, and results are those of single runs."""
    films, out = write_films(tmp_path / "films", COUNT, 60), tmp_path / "out"
    options = ("--every", 10)
    with cluster(2) as there:
        batch = start("batch", "background", films, "--out", out, *options, "--dask", there.address)
        victim = there.workers[0]
        wait_until(lambda: bool(ended(out)) and in_work(out, victim.pid))
        before = {path: stamp for folder in ended(out) for path, stamp in stamps(folder).items()}
        victim.kill()
        printed, complaints = batch.communicate(timeout=300)
    assert batch.returncode == 0, complaints
    assert printed.splitlines()[0] == f"{COUNT} videos: {COUNT} complete"
    assert before
    assert before.items() <= stamps(out).items()
    for film in sorted(films.iterdir()):
        alone = tmp_path / "alone" / film.name
        with pytest.raises(SystemExit):
            main(["background", str(film), "--out", str(alone), "--quiet", *map(str, options)])
        found, expected = results(out / film.name), results(alone)
        assert {name for name in found | expected if found.get(name) != expected.get(name)} == set()
