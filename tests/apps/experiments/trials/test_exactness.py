"""Belief propagation is exact on a small graph."""

from rsmcm.apps.experiments.trials.exactness import enumeration_error


def test_enumeration_agrees_with_the_engine() -> None:
    assert enumeration_error() <= 1e-12
