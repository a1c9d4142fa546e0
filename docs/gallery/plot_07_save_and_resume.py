"""
Save and load
=============

The state of a run is an immutable value: it can be kept, used for several continuations, saved and
loaded. A run that is stopped and resumed gives the same bytes as an uninterrupted one.
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
# The same in two halves. The file contains plain arrays and your own notes, and is written completely or
# not at all. Another process can load it later.

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
# **Branches.** What would the belief be if the camera had been dark for a second after the saved state?
# Missing frames are ``None``. A run does not change the state that it starts from, so any number of runs
# can start from it.

futures = {"as it was": images[75:], "a second of darkness": [None] * 25 + images[100:]}
figure, axes = plt.subplots(1, 3, figsize=(10, 2.8), layout="constrained")
axes[0].imshow(images[-1][..., ::-1])
axes[0].set_title("last frame")
for axis, (name, following) in zip(axes[1:], futures.items(), strict=True):
    *_, belief = engine.run(following, state=state)
    axis.imshow(belief[pixels].foreground(), cmap="gray")
    axis.set_title(f"{name}: identities {[track.identity for track in belief['blobs'].tracks()]}")
