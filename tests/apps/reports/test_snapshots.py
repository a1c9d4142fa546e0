"""A few pictures of a run of any length."""

import numpy as np
from numpy.typing import NDArray
from rsmcm.apps.reports.snapshots import Snapshots
from rsmcm.models import Frame

PICTURE = np.zeros((30, 600, 3), np.uint8)


def test_pictures_of_a_long_run_are_evenly_spaced() -> None:
    snapshots, drawn = Snapshots(), []

    def draw() -> NDArray[np.uint8]:
        drawn.append(PICTURE)
        return PICTURE

    for number in range(1, 1001):
        snapshots.add(Frame(PICTURE, number / 25, number), draw)
        kept = [each.number for each in snapshots]
        assert 1 <= len(kept) <= 8
        assert kept[0] == 1
        assert len(set(np.diff(kept))) <= 1
    assert len(snapshots) >= 4
    assert len(drawn) < 60, "drawn for few frames only"


def test_pictures_are_kept_small() -> None:
    for snapshots, width in ((Snapshots(), 480), (Snapshots(300), 300), (Snapshots(960), 600)):
        snapshots.add(Frame(PICTURE, 0.04, 1), lambda: PICTURE)
        assert [each.picture.shape[1] for each in snapshots] == [width]
        assert "frame 1, 0.0 s" in snapshots.row("overlay")
        assert snapshots.column().count("<img ") == 1
