"""Kalman filters of many things at once, and resampling."""
