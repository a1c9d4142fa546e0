"""What a background run keeps for its page: bounded memory whatever the stream's length."""

import json

from hypothesis import given
from hypothesis import strategies as st
from rsmcm.apps.background.record import MOST_POINTS, SERIES, RunRecord, TrackHistory
from rsmcm.apps.scenes import TruthBox
from rsmcm.models.core.frame import Frame

from ...support.records import MASK, PICTURE, recorded


def test_a_record_is_saved_as_json_and_goes_on_as_if_it_had_not_been() -> None:
    whole, record = recorded(40, frozenset({3, 25})), RunRecord()
    for number in range(1, 41):
        frame = Frame(None if number in (3, 25) else PICTURE, number / 25, number)
        tracks = [TruthBox(3, "pedestrian", (number % 7, 1.0, 2.0, 4.0))]
        record.add(frame, tracks, MASK, -160.0, 0.01)
        if number in (1, 24):
            record = RunRecord.restored(json.loads(json.dumps(record.saved())))
    for name in SERIES:
        assert getattr(record, name).tobytes() == getattr(whole, name).tobytes()
    assert vars(record.tracks[3]) == vars(whole.tracks[3])
    assert record.missing == whole.missing


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
