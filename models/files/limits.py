"""How much an input may hold: bounds on what readers take, checked before anything is unpacked."""

MOST_PIXELS = 1 << 27
"""Of one picture: 134 million, over four times those of 8K video, and 400 MB as colour."""

MOST_NUMBERS = 1 << 25
"""Of one file of arrays: 34 million, such as 10,000 frames of 1,600 points, and 270 MB as float64."""

MOST_TEXT = 1 << 25
"""Bytes of one text file: 900,000 boxes of ground truth, or a mesh of 400,000 vertices."""

MOST_SETTINGS = 1 << 20
"""Bytes of one file that people write by hand: parameters, correspondences, joints."""

LAST_FRAME = 10**9
"""The highest number of a frame: a camera reaches it after a year."""
