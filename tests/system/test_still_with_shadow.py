"""Mask and background must not confirm each other: a person who stays, with a soft shadow and reflections."""

import numpy as np
import pytest
from rsmcm.apps.background.application import build_model, read_frame_result
from rsmcm.apps.background.job import Engine
from rsmcm.inference import RecursiveBP

from ..support.room import standing_in_a_room

pytestmark = pytest.mark.slow

EARLY, LATE = slice(150, 250), slice(460, 560)
"""Frames in which he has just come, and has stood for a quarter of a minute."""


def shares(engine: Engine) -> list[tuple[float, float]]:
    """Early and late: what is found of him, and what is foreground beside him, over his own area."""
    scene = standing_in_a_room(560, size=(160, 120), stand=520)
    found, false, true = np.zeros((3, len(scene)))
    for k, (belief, mask) in enumerate(
        zip(RecursiveBP(build_model(engine)).run(scene), scene.masks, strict=True)
    ):
        foreground, person = read_frame_result(belief, (160, 120)).foreground > 0, mask > 0
        found[k], false[k], true[k] = (foreground & person).sum(), (foreground & ~person).sum(), person.sum()
    return [
        (float(found[w].sum() / true[w].sum()), float(false[w].sum() / true[w].sum())) for w in (EARLY, LATE)
    ]


def test_he_stays_and_his_shadow_becomes_background() -> None:
    (found_early, false_early), (found_late, false_late) = shares("recursive-bp")
    assert found_early > 0.8
    assert found_late > 0.8
    assert false_late < 0.5 * false_early
    assert false_late < 0.1


def test_without_feedback_he_is_swallowed() -> None:
    _, (found_late, _) = shares("feed-forward")
    assert found_late < 0.1
