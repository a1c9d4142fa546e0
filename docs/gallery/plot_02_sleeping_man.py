"""
A person who stands still
=========================

A background model alone absorbs a person who stands still. With the messages of the tracker, the person
stays foreground. The two models differ only in this feedback: in the second one the tracker receives the
pixels, but its message to them is removed.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

scene = sleeping_man(300, seed=0, size=(160, 120))
print(f"{len(scene)} frames at {1 / scene.dt:.0f} a second; the person stands for {scene.stand} of them")

# %%
# Both models process the same frames. The true mask of the person is known: we keep the share of it that
# each model labels as foreground, and its last mask and background image before the person walks on.

found, last = {}, {}
for name, feedback in (("with feedback", True), ("feed-forward", False)):
    pixels = PixelLabels()
    model = MultiChain().connect(AdaptiveBackground(), pixels)
    model.connect(BlobTracker(), pixels, feedback=feedback)
    beliefs = RecursiveBP(model).run(scene)
    for index, belief in enumerate(beliefs):
        mask, person = belief[pixels].foreground() > 0, scene.person(index)
        found.setdefault(name, []).append(mask[person].mean() if person.any() else np.nan)
        if index == 270:
            last[name] = mask, belief["background"].picture()
    print(f"{name}: {np.nanmean(found[name][150:270]):.0%} of the person in frames 151 to 270")

# %%
# Each row: the mask of frame 271 and the background image of a model. On the right, the detected share of
# the person over time. The lower background image contains the person. Try
# ``AdaptiveBackground(settle_time=2)``, which absorbs unexplained changes sooner.

figure, axes = plt.subplot_mosaic([["a", "b", "c"], ["d", "e", "c"]], figsize=(10, 3.6), layout="constrained")
for (left, right), (name, (mask, empty)) in zip(("ab", "de"), last.items(), strict=True):
    axes[left].imshow(mask, cmap="gray")
    axes[right].imshow(empty[..., ::-1])
    axes[left].set(title=f"{name}: mask", xticks=[], yticks=[])
    axes[right].set(title="background", xticks=[], yticks=[])
    axes["c"].plot(range(1, len(scene) + 1), found[name], label=name)
axes["c"].set(xlabel="frame", ylabel="share of the person found", ylim=(0, 1.02))
axes["c"].legend(loc="lower left")
