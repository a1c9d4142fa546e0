"""Rotation vectors and matrices against scipy and definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsmcm.models.numerics.rotations import cross_matrices, exponential, logarithm, nearest_rotation

seeds = st.integers(0, 10**6)


def test_no_turn_is_exact() -> None:
    np.testing.assert_array_equal(exponential(np.zeros((2, 3))), np.tile(np.eye(3), (2, 1, 1)))


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(1e-9, np.pi - 1e-6))
def test_logarithm_undoes_exponential(seed: int, angle: float) -> None:
    vectors = np.random.default_rng(seed).normal(size=(5, 3))
    vectors *= angle / np.linalg.norm(vectors, axis=1, keepdims=True)
    np.testing.assert_allclose(logarithm(exponential(vectors)), vectors, rtol=1e-6, atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_cross_matrices(seed: int) -> None:
    first, second = np.random.default_rng(seed).normal(size=(2, 4, 3))
    product = (cross_matrices(first) @ second[..., None])[..., 0]
    np.testing.assert_allclose(product, np.cross(first, second), atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_nearest_rotation_is_a_rotation_and_no_other_is_nearer(seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix = random.normal(size=(3, 3))
    nearest = nearest_rotation(matrix)
    np.testing.assert_allclose(nearest @ nearest.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(nearest) == pytest.approx(1)
    others = exponential(random.normal(size=(200, 3)) * random.uniform(0.001, 1)) @ nearest
    assert np.linalg.norm(others - matrix, axis=(1, 2)).min() >= np.linalg.norm(nearest - matrix) - 1e-12
