"""Joint answers of which thing is which part: against all of them, one by one."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.chains.body.flesh_assignment import JointAssignments, MovingParts, PartDetections, PartOptions
from rsmcm.models.core.gaussian_mixtures import GaussianMixtures


@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_the_best_answers_are_the_best_of_all(seed: int, k: int) -> None:
    """Two hypotheses, up to three things: each is one part, is clutter, or more of some part."""
    random = np.random.default_rng(seed)
    own, masses = random.normal(0, 1, 2), random.normal(0, 3, (2, 3, 2 * k + 1))
    known, gains = -random.exponential(2, (2, k)), random.choice([0.0, 3.0], (2, k))
    beside = random.exponential(1, (3, k, k))
    everything = {}
    for hypothesis, *answer in product(range(2), *3 * [range(2 * k + 1)]):
        things = [option for option in answer if option < k]
        if len(things) > len(set(things)):
            continue
        total = own[hypothesis]
        for part, option in enumerate(answer):
            total += masses[hypothesis, part, option]
            if option > k and option - k - 1 not in things:
                total += known[hypothesis, option - k - 1]
        for thing in set(range(k)) - set(things):
            new = 1 + sum(beside[part, option, thing] for part, option in enumerate(answer) if option < k)
            old = np.exp(gains[hypothesis, thing]) if gains[hypothesis, thing] > 0 else 0.0
            total += np.log(new + old)
        everything[hypothesis, *answer] = total
    found = JointAssignments.best(own, masses, known, gains, beside, np.zeros((k, k), np.bool_))
    best = sorted(everything.values(), reverse=True)[: len(found.log_masses)]
    np.testing.assert_allclose(found.log_masses, best, atol=1e-9)
    for hypothesis, options, value in zip(found.hypotheses, found.options, found.log_masses, strict=True):
        assert everything[int(hypothesis), *options.tolist()] == pytest.approx(value, abs=1e-9)


def test_things_are_what_mixtures_say() -> None:
    """Two blobs that either hand may be, and a face."""
    blobs, face = np.array([[10.0, 20.0], [30.0, 40.0]]), np.array([[50.0, 60.0]])
    one = np.eye(2)[None]
    mixtures = GaussianMixtures.of_parts(
        [[3.0], [1.0, 2.0], [1.0, 2.0]],
        [face, blobs, blobs],
        [one, np.repeat(one, 2, 0), np.repeat(one, 2, 0)],
        np.log([0.1, 0.2, 0.2]),
        [[7], [4, 5], [4, 5]],
    )
    things = PartDetections.from_mixtures(mixtures, 3)
    np.testing.assert_array_equal(things.labels, [4, 5, 7])
    np.testing.assert_array_equal(things.means, [*blobs, *face])
    np.testing.assert_allclose(things.probabilities, [0.9, 0.8, 0.8])
    np.testing.assert_allclose(things.log_ratios[1], [1 - np.log(0.8), 2 - np.log(0.8), -np.inf])
    np.testing.assert_allclose(things.log_ratios[0], [-np.inf, -np.inf, 3 - np.log(0.9)])
    assert not len(PartDetections.from_mixtures(None, 3).labels)


def test_a_thing_of_which_a_mixture_says_that_the_part_was_missed_is_one_all_the_same() -> None:
    """The flat share of a product of mixtures may be more than 1: all masses are numbers."""
    blob, one = np.array([[10.0, 20.0]]), np.eye(2)[None]
    parts = MovingParts(np.tile([12.0, 20.0, 0.0, 0.0], (1, 3, 1)), np.tile(4 * np.eye(4), (1, 3, 1, 1)))
    masses = []
    for flat in (0.999, 1.0, 1.5):
        mixtures = GaussianMixtures.of_parts([[3.0]] * 3, [blob] * 3, [one] * 3, [np.log(flat)] * 3)
        things = PartDetections.from_mixtures(mixtures, 3)
        sure = np.full((1, 3), 0.9)
        masses.append(PartOptions.of(parts, parts, sure, sure, things, np.ones(1)).log_masses)
        assert np.isfinite(masses[-1]).all()
    np.testing.assert_allclose(masses[1][..., 0], masses[0][..., 0], atol=1e-6)
    np.testing.assert_allclose(masses[2][..., 0], masses[0][..., 0], atol=1e-6)


def test_parts_of_which_nothing_is_said_are_no_thing() -> None:
    """Only a face was found: hands are not seen."""
    mixtures = GaussianMixtures.of_parts(
        [[3.0], [], []],
        [np.array([[10.0, 20.0]]), np.zeros((0, 2)), np.zeros((0, 2))],
        [np.eye(2)[None], np.zeros((0, 2, 2)), np.zeros((0, 2, 2))],
        np.log([0.1, 1.0, 1.0]),
    )
    things = PartDetections.from_mixtures(mixtures, 3)
    np.testing.assert_array_equal(things.probabilities, [0.9, 0.0, 0.0])
    np.testing.assert_array_equal(things.log_ratios[1:], -np.inf)
