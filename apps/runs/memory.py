"""What a run needs in memory beside the program itself, and whether the machine has it.

Measured as growth of the resident memory with size, frames, experts and samples, and rounded up; the tests
measure it again.
"""

import psutil

BACKGROUND = {"gaussian": 220, "mixture": 300}
"""Bytes per pixel, by the model of the background: 7 or 10 GB for 8K.

A whole film of the Gaussian needs most, 190 to 210; online it is 105 to 115, and 160 where the camera moves.
"""

STRUCTURE, STRUCTURE_FRAME = 220, 6
"""Bytes per pixel, and per pixel of each frame, all of which are held."""

STRUCTURE_POINTS = 720_000
"""Bytes per frame: normal equations of 800 points that trackers and matches follow, 900 bytes each."""

FACE, EXPERT = 40, 200_000
"""Bytes per pixel, and per expert."""

BODY, SAMPLE = 180, 5_000
"""Bytes per pixel, and per sample."""

KEPT_IMAGE, KEPT_SAMPLE = 24, 250
"""Bytes per pixel and per sample of each frame that waits for later ones.

A picture of a small head; of one that fills a quarter of the height, a third is kept.
"""

GIGA = 1e9


def check_memory(name: str, size: tuple[int, int], per_pixel: float, beside: float = 0) -> None:
    """Refuse a run that would need more memory than there is, before it takes any.

    A source of `(width, height)` px needs bytes per pixel, and others beside; the ValueError says how many,
    and how many are available.
    """
    width, height = size
    needed, available = width * height * per_pixel + beside, psutil.virtual_memory().available
    if needed > available:
        raise ValueError(
            f"{name}: a run on {width}x{height} px with these settings needs about {needed / GIGA:.3g} GB of "
            f"memory, expected no more than the {available / GIGA:.3g} GB that are available"
        )
