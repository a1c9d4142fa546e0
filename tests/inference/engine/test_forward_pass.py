"""What a filter says in a sequence, worked out when it is asked for: as if it had been kept."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pytest
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import BatchIncoming, Belief, MultiChain, RecursiveBP
from rsmcm.inference.engine.recursive_bp import ForwardPass, RunState
from rsmcm.models import Frame, PixelLabels

N_FRAMES = 6


class Incoming:
    def __init__(self, frame: Frame) -> None:
        self.frame = frame


def filtering() -> tuple[RecursiveBP, Sequence[BatchIncoming], list[Belief]]:
    random = np.random.default_rng(0)
    images = random.integers(0, 256, (N_FRAMES, 24, 32), np.uint8)
    frames = [Frame(image, number / 10, number + 1) for number, image in enumerate(images)]
    pixels = PixelLabels()
    engine = RecursiveBP(MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels))
    incoming = cast(Any, [Incoming(frame) for frame in frames])
    return engine, incoming, list(engine.run(frames))


def test_in_any_order_a_frame_gives_what_the_filter_says_there() -> None:
    engine, incoming, beliefs = filtering()
    said = ForwardPass(engine, RunState(), incoming, lambda belief: belief["pixels"])
    assert len(said) == N_FRAMES
    for time in (0, 1, 1, 4, 5, 2, 0, -1):
        np.testing.assert_array_equal(said[time].log_odds(), beliefs[time]["pixels"].log_odds())
    for message, belief in zip(said[1:3], beliefs[1:3], strict=True):
        np.testing.assert_array_equal(message.log_odds(), belief["pixels"].log_odds())
    with pytest.raises(IndexError):
        said[N_FRAMES]


def test_forwards_a_frame_costs_one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    engine, incoming, _ = filtering()
    steps = []
    step = engine.step
    monkeypatch.setattr(engine, "step", lambda state, frame: steps.append(frame.number) or step(state, frame))
    said = ForwardPass(engine, RunState(), incoming, lambda belief: belief["pixels"])
    for time in range(N_FRAMES):
        said[time], said[time]
    assert steps == list(range(1, N_FRAMES + 1))
    said[1]
    assert steps[N_FRAMES:] == [1, 2]
