"""The empty scene, pixel by pixel, and a camera that moves before it."""
