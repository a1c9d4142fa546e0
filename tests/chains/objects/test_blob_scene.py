"""What a frame teaches blobs."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.scenes.crowd import crowd
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.chains.objects import blob_scene
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels


def test_what_is_learned_does_not_depend_on_where_in_memory_arrays_lie(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    learn_all, calls = blob_scene.learn_all, []

    def learn_anywhere(*arguments: Any) -> None:
        *others, scratch = arguments
        picture, results = others[5], []
        # what is worked out may lie right behind the picture, of which some blobs reach beyond the lower edge
        memory: NDArray[np.uint8] = np.zeros(picture.image.nbytes + scratch.nbytes + 100_000, np.uint8)
        image = memory[: picture.image.nbytes].reshape(picture.image.shape)
        image[:] = picture.image
        others[5] = picture._replace(image=image)
        before = [array.copy() for array in (others[3], *others[4], others[8])]
        for gap in (0, 2000, 100_000):
            for array, values in zip((others[3], *others[4], others[8]), before, strict=True):
                array[:] = values
            start = image.nbytes + gap
            learn_all(*others, memory[start : start + scratch.nbytes].view(np.float32))
            results.append([array.tobytes() for array in (others[3], *others[4], others[8])])
        assert results[0] == results[1] == results[2]
        ends = np.floor(others[1]["position"][:, 0] + 0.5) + others[1]["rows"]
        calls.append(bool((ends > len(image)).any()))

    monkeypatch.setattr(blob_scene, "learn_all", learn_anywhere)
    monkeypatch.setattr(blob_scene, "thread_count", lambda: 1)
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
    *_, last = RecursiveBP(model).run(crowd(10, 15, (240, 320)))
    assert len(last["blobs"].blobs) > 5
    assert any(calls)
