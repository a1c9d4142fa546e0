"""Compiled loops of messages."""
