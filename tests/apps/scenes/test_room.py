"""The generated room: only the person is foreground, shadow and reflection are there and are not."""

import cv2
import numpy as np

from ...support.room import standing_in_a_room

SMALL = (160, 120)


def test_shadow_and_reflection_are_seen_and_are_no_foreground() -> None:
    scene = standing_in_a_room(300, size=SMALL, stand=200, noise=0, light_drift=0)
    empty, seen = (scene[index].image.astype(int) for index in (0, 200))
    person = scene.foreground(200)
    assert person.any()
    assert not scene.foreground(0).any()
    near = cv2.dilate(person.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    changed = np.abs(seen - empty).max(axis=2)
    gloss = np.s_[17:89, 99:147]
    assert (changed[gloss] > 20).sum() > 50  # the reflection in the door
    shadow = (seen - empty).mean(axis=2)
    shadow[near], shadow[gloss] = 0, 0
    assert (shadow < -15).sum() > 100
    ratio = seen[60:80, 40:60].mean() / empty[60:80, 40:60].mean()
    assert 0.6 < ratio < 1
