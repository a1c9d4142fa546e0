"""
A whole film at once
====================

Somebody is there from the first frame on, and leaves later. Frame by frame he is taken for a part of the
scene, since nothing else was ever seen there, and when he walks off, a ghost of him is left. With all of
the film at hand there is no such riddle: the place is empty in the end.

``CoordinateAscent`` works on sequences: chain after chain gets its best trajectory, the others held fixed.
Here one chain is ``SceneFilter``, which is a filter's background and tracker, begun with the empty scene
that is found in frames all over the film. The other one, ``ObjectTrajectories``, says who was where, given
what came before and after.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker, ObjectTrajectories, SceneFilter
from rsmcm.inference import CoordinateAscent, MultiChain, RecursiveBP
from rsmcm.models import ObjectBoxes, PixelLabels

scene = sleeping_man(400, seed=3, size=(160, 120), car_leaves=400)
film = scene[250:]  # he stands until frame 295 or so
masks = {}

# %%
# Frame by frame.

pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
filters = MultiChain().connect(AdaptiveBackground(), pixels).connect(blobs, pixels).connect(blobs, objects)
masks["frame by frame"] = [belief[pixels].foreground() > 0 for belief in RecursiveBP(filters).run(film)]

# %%
# The same filter as one chain of a model for the whole film. It meets features of its own.

whole, trajectories, pixels, objects = (
    SceneFilter(filters),
    ObjectTrajectories(),
    PixelLabels(),
    ObjectBoxes(),
)
model = MultiChain().connect(whole, pixels).connect(whole, objects).connect(trajectories, objects)
solution = CoordinateAscent(model, most_rounds=1, tolerance=None).run(film)
masks["the whole film"] = [belief.foreground() > 0 for belief in solution[pixels]]
for track in solution[trajectories].at(60):
    print(f"frame {film[60].number}: object {track.identity}, box {np.round(track.box).astype(int)} px")

# %%
# Masks of the first frame, and of one in which he walks. Right: what mask and person have in common, as a
# share of all that is one or the other. What stays missing while he stands are his trousers, which look
# like the street behind them. Let the film begin earlier, ``scene[200:]``: he is then there for most of it,
# and is the empty scene.

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
