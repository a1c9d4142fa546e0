"""Draw street.png, the picture of README: python docs/pictures/street.py."""

from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

FRAME = 200
"""The person has been standing still for six seconds."""

TINT = np.array([240, 60, 60])


def figure() -> Figure:
    """A frame; what the background by itself finds in it; what it finds when it hears the tracker."""
    scene = sleeping_man(400)[:FRAME]
    alone, pixels = PixelLabels(), PixelLabels()
    by_itself = MultiChain().connect(AdaptiveBackground(), alone)
    together = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
    *_, lost = RecursiveBP(by_itself).run(scene)
    *_, kept = RecursiveBP(together).run(scene)
    image = cv2.cvtColor(scene[-1].image, cv2.COLOR_BGR2RGB)
    drawn, panels = plt.subplots(1, 3, figsize=(9, 2.75), dpi=100, layout="constrained")
    masks = (None, lost[alone].foreground(), kept[pixels].foreground())
    titles = ("a person stands still", "background by itself", "background and tracker")
    for axes, mask, title in zip(panels, masks, titles, strict=True):
        shown = image.astype(float)
        if mask is not None:
            shown = 0.35 * shown + 0.65 * 235
            shown[mask > 0] = 0.25 * image[mask > 0] + 0.75 * TINT
        axes.imshow(shown.astype(np.uint8))
        axes.set_title(title, fontsize=11)
        axes.set_axis_off()
    for track in kept["blobs"].tracks():
        x, y, width, height = track.box
        panels[2].add_patch(plt.Rectangle((x, y), width, height, fill=False, linewidth=1.5, color="black"))
        panels[2].text(x, y - 4, f"object {track.identity}", fontsize=8)
    return drawn


if __name__ == "__main__":
    path = Path(__file__).with_suffix(".png")
    figure().savefig(path)
    Image.open(path).convert("RGB").quantize(256).save(path, optimize=True)
