"""Pluggable chains, one a file."""

from .adaptive_background import AdaptiveBackground
from .blob_tracker import BlobTracker

__all__ = ["AdaptiveBackground", "BlobTracker"]
