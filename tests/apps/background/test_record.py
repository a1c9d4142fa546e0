"""What a background run keeps for its report: bounded memory whatever the stream's length."""

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.background.record import MOST_POINTS, SERIES, RunRecord, TrackHistory
from rsmcm.apps.reports.snapshots import MOST_SNAPSHOTS
from rsmcm.apps.scenes import TruthBox
from rsmcm.models.core.frame import Frame

from ...support.records import MASK, PICTURE, recorded


def test_a_record_is_saved_as_json_and_goes_on_as_if_it_had_not_been() -> None:
    whole, record = recorded(40, frozenset({3, 25})), RunRecord()
    for number in range(1, 41):
        frame = Frame(None if number in (3, 25) else PICTURE, number / 25, number)
        tracks = [TruthBox(3, "pedestrian", (number % 7, 1.0, 2.0, 4.0))]
        record.add(frame, tracks, MASK, lambda: PICTURE, lambda: PICTURE, -160.0, 0.01)
        if number in (1, 24):
            record = RunRecord.restored(json.loads(json.dumps(record.saved())))
    for name in SERIES:
        assert getattr(record, name).tobytes() == getattr(whole, name).tobytes()
    assert vars(record.tracks[3]) == vars(whole.tracks[3])
    assert record.missing == whole.missing
    assert [each.number for each in record.snapshots.kept] == [each.number for each in whole.snapshots.kept]
    for one, other in zip(record.snapshots.kept, whole.snapshots.kept, strict=True):
        np.testing.assert_array_equal(one.foreground, other.foreground)
        assert one.picture.shape == other.picture.shape


@given(n_frames=st.integers(1, 700), missing=st.frozensets(st.integers(1, 700), max_size=30))
def test_snapshots_stay_few_and_spread(n_frames: int, missing: frozenset[int]) -> None:
    record = RunRecord()
    for number in range(1, n_frames + 1):
        image = None if number in missing else PICTURE
        record.add(Frame(image, 0.0, number), [], MASK, lambda: PICTURE, lambda: PICTURE, 0.0, 0.0)
    numbers = [snapshot.number for snapshot in record.snapshots.kept]
    assert len(numbers) <= MOST_SNAPSHOTS
    assert not missing & set(numbers)
    assert record.missing == sorted(number for number in missing if number <= n_frames)
    if not missing:
        gaps = np.diff(numbers)
        assert len(set(gaps.tolist())) <= 1
        assert len(numbers) >= min(n_frames, MOST_SNAPSHOTS // 2 + 1)


def test_pictures_are_made_for_few_frames_only() -> None:
    calls = []

    def made() -> np.ndarray:
        calls.append(1)
        return PICTURE

    record = RunRecord()
    for number in range(1, 10_001):
        record.add(Frame(PICTURE, 0.0, number), [], MASK, made, made, 0.0, 0.0)
    assert len(calls) < 200


def test_snapshots_are_small_copies() -> None:
    large = np.zeros((500, 1000, 3), np.uint8)
    record = RunRecord()
    record.add(Frame(large, 0.0, 1), [], large[..., 0], lambda: large, lambda: large, 0.0, 0.0)
    assert record.snapshots.kept[0].picture.shape == (240, 480, 3)
    small = PICTURE.copy()
    record.add(Frame(small, 0.0, 2), [], MASK, lambda: small, lambda: small, 0.0, 0.0)
    assert not np.shares_memory(record.snapshots.kept[1].picture, small)


@given(n_frames=st.integers(1, 3000))
def test_path_of_a_track_is_bounded_and_ends_where_it_ended(n_frames: int) -> None:
    history = TrackHistory(first=1)
    for number in range(1, n_frames + 1):
        history.add(number, (float(number), 0.0, 2.0, 4.0))
    assert len(history.path.kept) <= MOST_POINTS
    assert history.path.kept[0] == (2.0, 4.0)
    assert history.foot == (n_frames + 1.0, 4.0)
    assert (history.last, history.n_frames) == (n_frames, n_frames)
    assert history.width / history.n_frames == 2


@given(n_frames=st.integers(1, 700), more=st.integers(0, 300))
def test_few_pictures_are_made_in_vain_where_the_length_is_known(n_frames: int, more: int) -> None:
    calls = []

    def made() -> np.ndarray:
        calls.append(1)
        return PICTURE

    record = RunRecord()
    record.expect(n_frames)
    for number in range(1, n_frames + more + 1):
        record.add(Frame(PICTURE, 0.0, number), [], MASK, lambda: PICTURE, made, 0.0, 0.0)
        if number == n_frames:
            assert len(calls) <= 2 * MOST_SNAPSHOTS
            assert len(record.snapshots.kept) >= min(n_frames, MOST_SNAPSHOTS // 2 + 1)
    assert len(record.snapshots.kept) <= MOST_SNAPSHOTS
