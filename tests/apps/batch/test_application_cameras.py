"""A batch of live cameras: all at once, whatever becomes of one of them."""

import csv
from pathlib import Path

import numpy as np
import pytest
from rsmcm.apps.command_line import main

from ...support.stream_server import Connection, StreamServer, serving


@pytest.mark.slow
def test_cameras_run_at_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scene = np.random.default_rng(0).integers(60, 200, (48, 64, 3)).astype(np.uint8)
    steady = StreamServer([scene] * 2000, [Connection(2000)])
    lost = StreamServer([scene] * 2000, [Connection(40)])
    with serving(steady.answer) as one, serving(lost.answer) as other:
        listed = tmp_path / "cameras.toml"
        listed.write_text(
            f'masks = "none"\n[[camera]]\nname = "one"\nsource = "{one}"\nstop = 60\n'
            f'[[camera]]\nname = "other"\nsource = "{other}"\n'
        )
        with pytest.raises(SystemExit) as ended:
            main(["batch", "background", str(listed), "--out", str(tmp_path / "out")])
    out, err = capfd.readouterr()
    assert ended.value.code == 1
    assert out.splitlines()[0] == "2 videos: 1 complete, 1 lost"
    assert err.splitlines()[-1].startswith(f"rsmcm: {other}: lost permanently: ")
    with (tmp_path / "out" / "summary.csv").open(newline="") as file:
        rows = {row["folder"]: row for row in csv.DictReader(file)}
    assert rows["one"]["state"] == "complete"
    assert 0 < int(rows["other"]["frames"]) <= 40
