"""Blobs that are looked for on several threads at once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.scenes.crowd import crowd
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.chains.objects import blob_scene
from rsmcm.chains.objects.blob_records import RECORD
from rsmcm.chains.objects.registration import assign_shards, patch_bounds
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels
from rsmcm.models.numerics.threads import set_threads, thread_count


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(1, 4))
def test_blobs_that_may_meet_are_in_one_lot(seed: int, n_blobs: int, count: int) -> None:
    random = np.random.default_rng(seed)
    table = np.zeros(n_blobs, RECORD)
    table["position"] = random.integers(0, 400, (n_blobs, 2))
    table["rows"], table["columns"] = random.integers(10, 50, (2, n_blobs))
    shards = np.zeros(n_blobs, np.int64)
    assign_shards(table, count, shards)
    assert shards.min() >= 0
    assert shards.max() < count
    for behind in range(n_blobs):
        top, left, rows, columns = patch_bounds(table[behind])
        for front in range(behind):
            # its smallest reach is 2 px, and it covers pixels of its own box alone
            first = table["position"][front] - 2
            room = [table["rows"][front] + 4, table["columns"][front] + 4]
            overlap = np.minimum(first + room, [top + rows, left + columns]) - np.maximum(first, [top, left])
            if (overlap > 0).all():
                assert shards[behind] == shards[front]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_lots_may_be_done_in_any_order(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    frames, results = list(crowd(10, 30, (240, 320))), []
    monkeypatch.setattr(blob_scene, "thread_count", lambda: count)
    for order in (1, -1):
        monkeypatch.setattr(
            blob_scene, "side_by_side", lambda works, order=order: [w() for w in works[::order]]
        )
        results.append(states_of(frames))
    monkeypatch.setattr(blob_scene, "thread_count", lambda: 1)
    assert results[0] == results[1] == states_of(frames)


def states_of(frames: list[NDArray[np.uint8]]) -> list[bytes]:
    """All that is known of blobs after each frame."""
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
    states = [belief["blobs"].blobs for belief in RecursiveBP(model).run(frames)]
    assert len(states[-1]) > 5
    return [blobs.words.tobytes() + blobs.masks.tobytes() for blobs in states]


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bytes(threads: int) -> None:
    frames = list(crowd(12, 25, (300, 400)))
    before = thread_count()
    try:
        set_threads(1)
        alone = states_of(frames)
        set_threads(threads)
        assert states_of(frames) == alone
    finally:
        set_threads(before)
