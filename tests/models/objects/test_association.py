"""Belief propagation for assignments against the sum over all of them."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.objects.association import assignment_marginals

Numbers = NDArray[np.float64]


def enumerated(weights: Numbers, missed: Numbers) -> tuple[Numbers, Numbers, float]:
    """Marginals of pairs and of what is missed, and log of the sum, over all one-to-one assignments."""
    n_objects, n_boxes = weights.shape
    pairs, alone, total = np.zeros_like(weights), np.zeros(n_objects), 0.0
    for chosen in product(range(-1, n_boxes), repeat=n_objects):
        taken = [box for box in chosen if box >= 0]
        if len(set(taken)) < len(taken):
            continue
        value = np.prod([missed[k] if box < 0 else weights[k, box] for k, box in enumerate(chosen)])
        total += value
        for k, box in enumerate(chosen):
            if box < 0:
                alone[k] += value
            else:
                pairs[k, box] += value
    return pairs / total, alone / total, float(np.log(total))


def problem(seed: int, most: int = 3) -> tuple[Numbers, Numbers]:
    random = np.random.default_rng(seed)
    n_objects, n_boxes = random.integers(0, most + 1, 2)
    weights = np.exp(random.normal(0, random.choice([0.5, 3.0]), (n_objects, n_boxes)))
    return weights, random.uniform(0.05, 1, n_objects)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32))
def test_every_object_and_every_box_is_one_thing(seed: int) -> None:
    found = assignment_marginals(*problem(seed, 6))
    np.testing.assert_allclose(found.pairs.sum(axis=1) + found.missed, 1, atol=1e-9)
    np.testing.assert_allclose(found.pairs.sum(axis=0) + found.alone, 1, atol=2e-3)


def test_marginals_are_close_to_those_of_all_assignments() -> None:
    """Loops make Bethe's approximation err: rarely by more than 0.1."""
    worst = []
    for seed in range(300):
        weights, missed = problem(seed)
        found = assignment_marginals(weights, missed)
        pairs, alone, _ = enumerated(weights, missed)
        worst.append(np.abs(np.column_stack([found.pairs - pairs, found.missed - alone])).max(initial=0.0))
    assert np.mean(worst) < 0.02
    assert np.mean(np.array(worst) > 0.1) < 0.02


@pytest.mark.parametrize(("n_objects", "n_boxes"), [(1, 4), (4, 1), (1, 1), (3, 0), (0, 3)])
def test_marginals_and_sum_are_exact_without_loops(n_objects: int, n_boxes: int) -> None:
    random = np.random.default_rng(n_objects + 10 * n_boxes)
    weights, missed = random.exponential(2, (n_objects, n_boxes)), random.uniform(0.05, 1, n_objects)
    found = assignment_marginals(weights, missed)
    pairs, alone, log_sum = enumerated(weights, missed)
    np.testing.assert_allclose(found.pairs, pairs, atol=1e-5)
    np.testing.assert_allclose(found.missed, alone, atol=1e-5)
    assert found.log_sum == pytest.approx(log_sum, abs=1e-5)
