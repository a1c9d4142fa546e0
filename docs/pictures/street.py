"""Draw street.webp, the moving picture of README: python docs/pictures/street.py.

A frame of a generated street; what the background by itself finds in it; what it finds when it hears the
tracker. The person stands still from the fifth to the thirteenth second.
"""

from pathlib import Path

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

FIRST, LAST, STEP = 60, 360, 5
SPEED = 2
"""Times real time."""

TINT = np.array([240, 60, 60])
TITLES = ("a person stands still", "background alone", "background and tracker")
GAP, HEAD = 8, 26  # px between the panels, and of their titles
FONT = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 15)


def panel(image: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The frame, pale, with its foreground in red."""
    shown = 0.35 * image + 0.65 * 235
    shown[mask > 0] = 0.25 * image[mask > 0] + 0.75 * TINT
    return shown.astype(np.uint8)


def pictures() -> list[Image.Image]:
    """All three panels for every STEP-th frame."""
    scene = sleeping_man(LAST)
    alone, pixels = PixelLabels(), PixelLabels()
    by_itself = MultiChain().connect(AdaptiveBackground(), alone)
    together = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
    drawn = []
    for lost, kept in zip(RecursiveBP(by_itself).run(scene), RecursiveBP(together).run(scene), strict=True):
        number, image = lost.frame.number, lost.frame.image[..., ::-1]
        if number < FIRST or number % STEP:
            continue
        width, height = scene.size
        picture = Image.new("RGB", (3 * width + 2 * GAP, height + HEAD), "white")
        pen = ImageDraw.Draw(picture)
        panels = (image, panel(image, lost[alone].foreground()), panel(image, kept[pixels].foreground()))
        for left, title, shown in zip(range(0, 3 * width, width + GAP), TITLES, panels, strict=False):
            picture.paste(Image.fromarray(np.ascontiguousarray(shown)), (left, HEAD))
            pen.text((left + width / 2, HEAD / 2), title, "black", FONT, "mm")
        for track in kept["blobs"].tracks():
            x, y, across, down = track.box
            x, y = x + 2 * (width + GAP), y + HEAD
            pen.rectangle((x, y, x + across, y + down), outline="black", width=2)
            pen.text((x, y - 3), f"object {track.identity}", "black", FONT, "ls")
        pen.text((8, HEAD + 6), f"{lost.frame.time:.0f} s", "white", FONT)
        drawn.append(picture)
    return drawn


if __name__ == "__main__":
    first, *others = pictures()
    first.save(
        Path(__file__).with_suffix(".webp"),
        save_all=True,
        append_images=others,
        duration=round(1000 * STEP / 25 / SPEED),
        loop=0,
        quality=30,
        method=4,
    )
