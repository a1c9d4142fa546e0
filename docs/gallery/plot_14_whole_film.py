"""
A whole video at once
=====================

A person is there from the first frame on, and leaves later. Frame by frame, the person becomes part of
the background, and leaves a ghost. With the whole video there is no ambiguity: the place is empty
in the end.

``CoordinateAscent`` works on sequences: each chain in turn gets its best trajectory, while the others are
fixed. One chain here is ``SceneFilter``, a background model and a tracker that start with the background
found in frames from the whole video. The other one, ``ObjectTrajectories``, smooths the tracks in both
directions.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker, ObjectTrajectories, SceneFilter
from rsmcm.inference import CoordinateAscent, MultiChain, RecursiveBP
from rsmcm.models import ObjectBoxes, PixelLabels

scene = sleeping_man(400, seed=3, size=(160, 120), car_leaves=400)
film = scene[250:]  # the person stands until about frame 295
masks = {}

# %%
# Frame by frame.

pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
filters = MultiChain().connect(AdaptiveBackground(), pixels).connect(blobs, pixels).connect(blobs, objects)
masks["frame by frame"] = [belief[pixels].foreground() > 0 for belief in RecursiveBP(filters).run(film)]

# %%
# The same filter as one chain of a model for the whole video, with its own features.

whole, trajectories, pixels, objects = (
    SceneFilter(filters),
    ObjectTrajectories(),
    PixelLabels(),
    ObjectBoxes(),
)
model = MultiChain().connect(whole, pixels).connect(whole, objects).connect(trajectories, objects)
solution = CoordinateAscent(model, most_rounds=1, tolerance=None).run(film)
masks["whole video"] = [belief.foreground() > 0 for belief in solution[pixels]]
for track in solution[trajectories].at(60):
    print(f"frame {film[60].number}: object {track.identity}, box {np.round(track.box).astype(int)} px")

# %%
# Masks of the first frame, and of one in which the person walks. Right: intersection over union of mask
# and person. The trousers, which look like the street, are missing while the person stands. Start the
# video earlier, ``scene[200:]``: the person is then there for most of it, and becomes background.

figure, axes = plt.subplot_mosaic([["a", "b", "e"], ["c", "d", "e"]], figsize=(10, 3.8), layout="constrained")
person = np.array([scene.person(frame.number - 1) for frame in film])
for (first, later), (name, found) in zip(("ab", "cd"), masks.items(), strict=True):
    axes[first].imshow(found[0], cmap="gray")
    axes[later].imshow(found[60], cmap="gray")
    axes[first].set(title=f"{name}: frame 251", xticks=[], yticks=[])
    axes[later].set(title="frame 311", xticks=[], yticks=[])
    share = np.sum(person & found, axis=(1, 2)) / np.maximum(np.sum(person | found, axis=(1, 2)), 1)
    axes["e"].plot(range(251, 351), share[:100], label=name)
axes["e"].set(xlabel="frame", ylabel="intersection over union", ylim=(0, 1))
axes["e"].legend(loc="upper left")
