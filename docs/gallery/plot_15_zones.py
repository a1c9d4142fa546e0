"""
Entries, exits and stays
========================

A zone is a polygon in the image, a line has two sides, and the position of an object is that of its feet.
An event is only reported when it is certain, so feet on a border do not flicker. Since the tracker keeps
standing people, durations of stays are complete.
"""

import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.events import Line, Sighting, Watch, Zone, Zones
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import PixelLabels

scene = sleeping_man(360, seed=0, size=(160, 120), car_leaves=400)
door = Zone("door", np.array([(50, 95), (95, 95), (95, 120), (50, 120)]), scene.size)
gate = Line("gate", (30, 120), (30, 90), left_to_right="in", right_to_left="out")
watch = Watch(Zones((door,), (gate,), still_after=2.0))

# %%
# A zone has no border at the edge of the image, where no entry is visible. ``Watch.update`` takes the tracks
# of each frame and returns the events that have become certain, with their times. Events that take longer to
# detect, such as the end of standing, may follow later ones.

pixels = PixelLabels()
model = MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels)
events, feet = [], []
for belief in RecursiveBP(model).run(scene):
    seen = []
    for track in belief["blobs"].tracks():
        x, y, width, height = track.box
        seen.append(Sighting(track.identity, x + width / 2, y + height, height, track.seen))
    feet += [(belief.frame.time, one.x, one.y) for one in seen]
    events += watch.update(belief.frame.time, belief.frame.number, seen)
events += watch.end(len(scene))
for event in events:
    lasted = "" if event.duration is None else f", after {event.duration:.1f} s"
    print(f"{event.moment.time:5.2f} s: {event.identity} {event.kind} {event.zone} {event.direction}{lasted}")

# %%
# Left: the path of the feet, the zone and the line. Right: the position over time, with the events. Try a
# longer ``still_after``, or a zone that the person only crosses. ``rsmcm background --zones FILE`` does
# the same for a video.

figure, (shown, axis) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
shown.imshow(scene[200].image[..., ::-1])
shown.fill(*door.polygon.T, color="orange", alpha=0.4)
shown.plot(*zip(gate.start, gate.end, strict=True), color="red")
shown.plot([x for _, x, _ in feet], [y for _, _, y in feet], "w.", markersize=2)
shown.set(xlim=(0, 160), ylim=(120, 0))
axis.plot([time for time, _, _ in feet], [x for _, x, _ in feet], ".", markersize=3)
axis.axhspan(50, 95, color="orange", alpha=0.3)
axis.axhline(30, color="red")
for event in events:
    axis.plot(event.moment.time, event.moment.x, "ko")
    axis.annotate(event.kind, (event.moment.time, event.moment.x), (5, -12), textcoords="offset points")
axis.set(xlabel="s", ylabel="x of the feet, px")
