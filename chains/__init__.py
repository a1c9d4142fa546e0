"""Pluggable chains, one a file."""

from .adaptive_background import AdaptiveBackground

__all__ = ["AdaptiveBackground"]
