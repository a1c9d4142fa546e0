"""
A third level: the ground
=========================

``GroundPlane`` learns the perspective of a scene from the people who walk through it: the height of a
person whose feet are in a given row. It shares a second feature with the tracker, the boxes of objects,
and receives no pixels. Its messages give the size of objects that are half visible, or new.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle
from rsmcm.chains import AdaptiveBackground, BlobTracker, GroundPlane
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import Frame, ObjectBoxes, PixelLabels

# %%
# Three simple figures walk back and forth at different depths. With feet in row :math:`y` they are
# :math:`(y - 60) / 2` px tall; this is the true perspective.

random = np.random.default_rng(0)
street = random.integers(100, 130, (240, 320, 1)).repeat(3, axis=2)
people = (120, 0.0, (40, 60, 170)), (165, 2.0, (180, 70, 50)), (225, 0.4, (40, 160, 40))


def image(k):
    picture = street + random.normal(0, 3, street.shape)
    for feet, phase, colour in people if k > 5 else ():
        tall, x = (feet - 60) // 2, round(160 + 110 * np.sin(0.03 * k + phase))
        picture[feet - tall : feet, x - tall // 6 : x + tall // 6] = colour
    return picture.clip(0, 255).astype(np.uint8)


# %%
# The second line of the model adds the third level: the tracker is connected to both features. The output
# is the predicted height of a new person.

pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
model = MultiChain().connect(AdaptiveBackground(), pixels).connect(blobs, pixels)
model.connect(blobs, objects).connect(GroundPlane(), objects)
frames = [Frame(image(k), k / 10, k + 1) for k in range(120)]
*_, belief = RecursiveBP(model).run(frames)
rows = np.arange(80, 239, 20)
mean, deviation = belief["ground"].expected_height(rows)
for k in (1, 4, 7):
    print(f"feet in row {rows[k]}: {mean[k]:.0f} +- {deviation[k]:.0f} px; truly {(rows[k] - 60) / 2:.0f}")

# %%
# Left: tracked people (white), and the predicted height of a new person (yellow), row by row. Right: the
# learned height with two standard deviations, and the true one (dashed); dots are the observed people.
# Remove two of them from ``people``: the height is then known for one row, and hardly elsewhere.

figure, (shown, axis) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
shown.imshow(frames[-1].image[..., ::-1])
for x, y, width, height in (boxes := belief[objects].objects.moments[1]):
    shown.add_patch(Rectangle((x - width / 2, y - height), width, height, fill=False, color="white"))
shown.vlines(150 + 20 * np.arange(len(rows)), rows - mean, rows, color="yellow")
axis.fill_between(rows, mean - 2 * deviation, mean + 2 * deviation, alpha=0.3)
axis.plot(rows, mean)
axis.plot(rows, (rows - 60) / 2, "k--")
axis.plot(boxes[:, 1], boxes[:, 3], "o")
axis.set(xlabel="row of the feet, px", ylabel="height, px")
