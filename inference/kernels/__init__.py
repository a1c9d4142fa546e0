"""Compiled loops of the Kalman filter."""
