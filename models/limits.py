"""How much an input may hold: bounds on what readers take, checked from headers before data are unpacked."""

MOST_PIXELS = 1 << 27
"""Of one picture: 134 million, over four times those of 8K video, and 400 MB as colour."""

MOST_BYTES = 1 << 30
"""Of one array file once it is unpacked, and of one text file."""
