"""Samples of a body's pose: dynamics, proposals, tempering."""
