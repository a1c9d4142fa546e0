"""Chains that are made of matrices or functions, beside those of a domain."""

from ..inference.engine.generic_chains import (
    DiscreteChain,
    DiscreteState,
    LinearGaussianChain,
    LinearGaussianState,
    ParticleChain,
    ParticleState,
)

__all__ = [
    "DiscreteChain",
    "DiscreteState",
    "LinearGaussianChain",
    "LinearGaussianState",
    "ParticleChain",
    "ParticleState",
]
