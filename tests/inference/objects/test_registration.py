"""Blobs that are looked for on several threads at once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.apps.experiments.bench.crowd_scene import crowd
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels
from rsmcm.models.numerics.threads import set_threads, thread_count
from rsmcm.models.objects.kernels.records import RECORD
from rsmcm.models.objects.kernels.registration import deal


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(1, 4))
def test_blobs_that_may_meet_are_in_one_lot(seed: int, n_blobs: int, count: int) -> None:
    random = np.random.default_rng(seed)
    table = np.zeros(n_blobs, RECORD)
    table["position"] = random.integers(0, 400, (n_blobs, 2))
    table["rows"], table["columns"] = random.integers(10, 50, (2, n_blobs))
    lots = np.zeros(n_blobs, np.int64)
    deal(table, count, lots)
    assert lots.min() >= 0
    assert lots.max() < count
    for one in range(n_blobs):
        for other in range(one):
            first = np.maximum(*(table["position"][k] - 2 for k in (one, other)))
            end = np.minimum(
                *(table["position"][k] + [table["rows"][k], table["columns"][k]] + 2 for k in (one, other))
            )
            if (first < end).all():
                assert lots[one] == lots[other]


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bytes(threads: int) -> None:
    frames = list(crowd(12, 25, (300, 400)))

    def run(count: int) -> list[bytes]:
        set_threads(count)
        pixels = PixelLabels()
        model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
        states = [belief["blobs"] for belief in RecursiveBP(model).run(frames)]
        assert len(states[-1].blobs) > 5
        return [blobs.words.tobytes() + blobs.masks.tobytes() for blobs in (each.blobs for each in states)]

    before = thread_count()
    try:
        assert run(threads) == run(1)
    finally:
        set_threads(before)
