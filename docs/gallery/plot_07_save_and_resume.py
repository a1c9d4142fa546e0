"""
Save, load, go on
=================

The state of a run is a value: it can be kept, branched from, saved and loaded. A run that is stopped and
resumed gives the same bytes as one that was never stopped.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

pixels = PixelLabels()
model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
engine, images = RecursiveBP(model), [frame.image for frame in sleeping_man(150, size=(160, 120))]
whole = [belief[pixels].foreground() for belief in engine.run(images)]

# %%
# The same in two halves. What is written is a file of plain arrays, whole or not at all, with whatever you
# want to know of it later. Another process, on another day, loads it.

with TemporaryDirectory() as folder:
    path = Path(folder) / "street.npz"
    *_, belief = engine.run(images[:75])
    engine.save(path, belief.state, about={"camera": "street"})
    print(f"saved after frame {belief.state.number}: {path.stat().st_size / 1000:.0f} kB")
    state, about = engine.load(path)
print(f"loaded: frame {state.number} of the camera {about['camera']!r}")
halves = [belief[pixels].foreground() for belief in engine.run(images[75:], state=state)]
print("the same masks:", all((one == two).all() for one, two in zip(whole[75:], halves, strict=True)))

# %%
# **Branches.** From the saved state, what would be believed had the camera been dark for a second? Missing
# frames are ``None``. The state is not changed by a run that begins with it, so any number of them can.

futures = {"as it was": images[75:], "a second of darkness": [None] * 25 + images[100:]}
figure, axes = plt.subplots(1, 3, figsize=(10, 2.8), layout="constrained")
axes[0].imshow(images[-1][..., ::-1])
axes[0].set_title("last frame")
for axis, (name, following) in zip(axes[1:], futures.items(), strict=True):
    *_, belief = engine.run(following, state=state)
    axis.imshow(belief[pixels].foreground(), cmap="gray")
    axis.set_title(f"{name}: identities {[track.identity for track in belief['blobs'].tracks()]}")
