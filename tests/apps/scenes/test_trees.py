"""The generated trees: leaves move and nothing else does, until a person comes."""

import numpy as np
from rsmcm.apps.scenes import waving_trees

SMALL = (160, 120)


def test_only_leaves_move_until_the_person_comes() -> None:
    scene = waving_trees(150, size=SMALL, enter=100, noise=0)
    pictures = np.stack([scene.render(index).image for index in range(0, 90, 6)]).astype(int)
    moving = np.ptp(pictures, axis=0).max(axis=2) > 30
    assert moving[scene.leaves].mean() > 0.5
    assert not moving[100:].any()
    assert not any(scene.foreground(index).any() for index in range(0, 90, 6))
    assert scene.foreground(140).any()
    # smoothly: the leaves of the next frame are nearly where they were
    steps = [np.abs(scene.render(k + 1).image.astype(int) - scene.render(k).image).mean() for k in range(5)]
    assert max(steps) < 0.5 * np.abs(pictures[0] - pictures[7]).mean()


def test_same_seed_same_bytes_in_any_order_and_calm_is_calm() -> None:
    one, other = waving_trees(30, seed=3, size=SMALL), waving_trees(30, seed=3, size=SMALL)
    late = one.render(20).image
    assert np.array_equal(one.render(5).image, other.render(5).image)
    assert np.array_equal(late, other.render(20).image)
    calm = waving_trees(30, size=SMALL, sway=0, noise=0)
    assert np.array_equal(calm.render(0).image, calm.render(20).image)
