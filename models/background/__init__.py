"""The empty scene, pixel by pixel, and what covers it."""
