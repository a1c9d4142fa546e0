"""What later frames say of the poses of earlier ones, and which hand is left."""

from .fixed_lag import BLOCK, FixedLag, TimedSamples, WaitingFrame, WaitingFrames
from .labelling import HandLabels, Labelling

__all__ = ["BLOCK", "FixedLag", "HandLabels", "Labelling", "TimedSamples", "WaitingFrame", "WaitingFrames"]
