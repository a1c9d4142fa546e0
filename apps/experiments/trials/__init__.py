"""Trackers tried on generated films, and competitors."""
