"""Claims on objects that one draw cannot prove: means over seeds and their standard errors."""

import numpy as np
import pytest
from rsmcm.apps.io import with_boxes
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker, DetectorRates
from rsmcm.inference import MultiChain, RecursiveBP
from rsmcm.models import ObjectBoxes, PixelLabels

from .test_blob_tracker import BLUE, DARK, DT, GROUND, SIZE, TALL, identities, run, texture
from .test_detector_rates import run as run_with_detector
from .test_detector_rates import walkers

pytestmark = pytest.mark.slow
ENTERING = [(TALL, -40, BLUE), (TALL, 60, DARK), ((40, 30), 60, BLUE)]
"""Size px, speed px/s and colour of what comes in over an edge."""


@pytest.mark.parametrize(("size", "speed", "colour"), ENTERING)
def test_what_enters_over_the_edge_is_one_object(size, speed, colour):
    """It was in 60 of 60 films; if it is not in 1 of 100, three of 20 are by a chance of 1 in 1000."""
    (height, width), start = size, -size[1] if speed > 0 else SIZE[1]
    counts = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        scene, thing = (
            texture(1000 * seed + k, each, c, contrast)
            for k, each, c, contrast in ((0, SIZE, GROUND, 15), (10, size, colour, 25))
        )
        images = []
        for number in range(int((width / abs(speed) + 2) / DT)):
            image = np.pad(scene, ((0, 0), (100, 100), (0, 0)))
            left = 100 + round(start + speed * number * DT)
            image[40 : 40 + height, left : left + width] = thing
            image = image[:, 100:-100] + random.normal(0, 4, scene.shape)
            images.append(np.clip(image, 0, 255).astype(np.uint8))
        counts.append(len(identities(run(images))))
    assert np.count_nonzero(np.array(counts) != 1) <= 2


def test_people_are_tracked_among_false_boxes_and_these_are_not():
    """Four people, misses in bursts of half a second, seven false boxes in ten frames, and empty pictures."""
    shares, wrong = [], []
    for seed in range(20):
        frames = walkers(seed, 120, found=0.8, clutter=0.7, scale=1.0)
        there = seen = false = 0
        for frame, belief in zip(frames[20:], run_with_detector(frames)[20:], strict=True):
            number = frame.number - 1
            x_of_feet = 80 + 130 * np.arange(4) + 2.0 * number * np.array([1, -1, 1, -1])
            feet = np.stack([x_of_feet, [250, 300, 350, 400]])
            there += np.count_nonzero((x_of_feet > 0) & (x_of_feet < 640))
            for track in belief["blobs"].tracks():
                x, y, width, height = track.box
                off = np.abs(feet - [[x + width / 2], [y + height]]).max(axis=0)
                seen, false = (seen + 1, false) if off.min() < 0.35 * height else (seen, false + 1)
        shares.append(seen / there)
        wrong.append(false / seen)
    assert mean_moved_by(shares, -3) > 0.8
    assert mean_moved_by(wrong, 3) < 0.05


def test_who_comes_in_with_a_rare_detector_keeps_a_track():
    """A person whom the border cuts at first, as does the box; the detector runs on every fifth frame."""
    counts = []
    for seed in range(20):
        scene, random = sleeping_man(320, seed=seed, car_leaves=400), np.random.default_rng(seed)

        def found(frame, scene=scene, random=random):
            rows = []
            for track in scene.boxes(frame.number - 1):
                x, y, width, height = np.array(track.box) + 0.03 * track.box[3] * random.normal(size=4)
                if random.random() < 0.8:
                    rows.append([x, y, x + width, y + height, random.normal(0.8, 0.1)])
            if random.random() < 0.3:
                x, y = random.uniform(0, 280), random.uniform(0, 140)
                rows.append([x, y, x + 35, y + 90, random.normal(0.5, 0.1)])
            return rows

        pixels, objects, blobs = PixelLabels(), ObjectBoxes(), BlobTracker()
        model = MultiChain().connect(AdaptiveBackground(), pixels).connect(blobs, pixels)
        model = model.connect(blobs, objects).connect(DetectorRates(), objects)
        names = set()
        for belief in RecursiveBP(model).run(with_boxes(scene, found, every=5)):
            people = [each.box for each in scene.boxes(belief.frame.number - 1)]
            for track in belief["blobs"].tracks():
                x, y, width, height = track.box
                if any(
                    abs(x + 0.5 * width - left - 0.5 * wide) < 0.5 * wide
                    and abs(y + height - top - high) < 0.4 * high
                    for left, top, wide, high in people
                ):
                    names.add(track.identity)
        counts.append(len(names))
    assert mean_moved_by(counts, 3) < 2


def mean_moved_by(values, deviations):
    """The mean moved by so many of its standard errors."""
    return np.mean(values) + deviations * np.std(values, ddof=1) / len(values) ** 0.5
