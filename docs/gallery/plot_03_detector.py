"""
A detector's boxes as evidence
==============================

A detector looks at single images: it misses people, reports false ones, and has no identities. Its boxes
are associated with the tracked objects by probabilities, and it need not run on every frame.

Here a detector is simulated from the truth of a generated street. It runs on every fifth frame, misses
the person in one frame out of five, and adds a false box in three frames out of ten.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle
from rsmcm.apps.io import with_boxes
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker, DetectorRates
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import ObjectBoxes, PixelLabels

scene, random = sleeping_man(320, seed=1, car_leaves=400), np.random.default_rng(1)


def detector(frame):
    rows = []  # left, top, right, bottom edge, px, and a score
    for truth in scene.boxes(frame.number - 1):
        x, y, width, height = np.array(truth.box) + 0.03 * truth.box[3] * random.normal(size=4)
        if random.random() < 0.8:
            rows.append([x, y, x + width, y + height, random.normal(0.8, 0.1)])
    if random.random() < 0.3:
        x, y = random.uniform(0, 280), random.uniform(0, 140)
        rows.append([x, y, x + 35, y + 90, random.normal(0.5, 0.1)])
    return rows


# %%
# The tracker receives the boxes at a second feature, ``ObjectBoxes``. There ``DetectorRates``, one more
# chain, learns how often the detector detects, how often it errs, and what its scores mean. There is no
# threshold.

pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
model = MultiChain().connect(AdaptiveBackground(), pixels).connect(blobs, pixels)
model.connect(blobs, objects).connect(DetectorRates(), objects)
beliefs, tracks, given = RecursiveBP(model).run(with_boxes(scene, detector, every=5)), [], []
for belief in beliefs:
    number, boxes = belief.frame.number, belief.frame.boxes
    tracks += [(number, track.identity, *track.box) for track in belief["blobs"].tracks()]
    given += [(number, *box) for box in (boxes.xyxy if boxes else ())]
rates = belief.message("detector", objects).detector
print(f"{len(given)} boxes in 64 frames; identities of tracks: {sorted({row[1] for row in tracks})}")
print(f"learned: detection probability {rates.found:.0%},")
print(f"{rates.clutter * 320 * 240:.2f} false boxes per frame,")
print(f"mean score of true boxes {rates.scores.true:.2f}, of false boxes {rates.scores.false:.2f}")

# %%
# Left: all boxes of the detector. Right: their positions over time (grey), and the track (green). In this
# run, false boxes lead to no track. In frames without the detector, and where it misses the person, the
# pixels continue the track. The second identity is an error: it is the same person, who walks off after
# standing for eight seconds. (Without the detector the identity is kept.) Try ``every=25``, or
# ``feedback=False`` for the chain of the detector.

figure, (shown, axis) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
shown.imshow(scene[200].image[..., ::-1])
for _, left, top, right, bottom in given:
    shown.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, color="white", alpha=0.5))
axis.vlines(*np.array(given)[:, [0, 1, 3]].T, color="grey", label="boxes of the detector")
axis.plot(*np.array([(number, x + width / 2) for number, _, x, _, width, _ in tracks]).T, "g.", label="track")
axis.set(xlabel="frame", ylabel="x, px")
axis.legend()
