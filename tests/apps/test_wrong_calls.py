"""Calls from Python with what does not fit: one line with the parameter, what came and what was expected."""

from collections.abc import Callable

import numpy as np
import pytest
from rsmcm.apps.evaluation import (
    PixelScore,
    error_classes,
    evaluate_tracks,
    mask_error_classes,
    report_validity,
)
from rsmcm.apps.events import Line, Sighting, Watch, Zone, Zones
from rsmcm.apps.exports import FinishedRun, read_tracks_table, to_coco, to_supervision
from rsmcm.apps.io import open_source, read_points, with_boxes
from rsmcm.apps.scenes import cylinder, face, shaken, sleeping_man, turntable

MASK = np.zeros((4, 5), np.uint8)
ZEROS = np.zeros
CORNERS = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]])
NAN = float("nan")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: PixelScore().add(1, MASK[:3], MASK),
            "labels: got shape (4, 5), expected shape",
        ),
        (lambda: PixelScore().add(1, MASK / 2, MASK), "foreground: got an array of float64"),
        (lambda: mask_error_classes(MASK, MASK[:3]), "labels: got shape (3, 5), expected shape"),
        (lambda: error_classes(MASK, 3), "truth: got 3, expected a BoxTruth"),
        (
            lambda: error_classes(MASK[None], 3),
            "foreground: got shape (1, 4, 5), expected",
        ),
        (lambda: evaluate_tracks(3, None), "tracks: got 3, expected an array"),
        (lambda: evaluate_tracks(ZEROS((0, 6)), None), "truth: got None, expected a BoxTruth or a MaskTruth"),
        (lambda: report_validity(3), "folder: got 3, expected a text or a Path"),
        (lambda: FinishedRun.of(3), "folder: got 3, expected a text or a Path"),
        (lambda: read_tracks_table(3), "path: got 3, expected a text or a Path"),
        (lambda: to_coco(3, "a.json"), "run: got 3, expected a text or a Path"),
        (lambda: to_supervision(3), "tracks: got 3, expected a sequence"),
        (lambda: to_supervision([3]), "tracks[0]: got 3, expected a TrackedObject"),
        (lambda: to_supervision([], ZEROS((3, 4))), "foreground: got an array of float64"),
        (lambda: sleeping_man("many"), "n_frames: got 'many', expected a whole number"),
        (lambda: sleeping_man(0), "n_frames: got 0, expected 1 or more"),
        (lambda: sleeping_man(size=(20, 20)), "size: got (20, 20), expected (width, height) of at least"),
        (lambda: sleeping_man(noise=NAN), "noise: got nan, expected a finite number"),
        (lambda: sleeping_man(light_drift=1.0), "light_drift: got 1.0, expected 0 or more and less than 1"),
        (lambda: face(motion="wild"), "motion: got 'wild', expected 'natural' or 'fast'"),
        (lambda: face(max_yaw=90), "max_yaw: got 90, expected 0 to 80"),
        (lambda: face(size=(60, 240)), "size: got (60, 240), expected (width, height) of at least"),
        (lambda: cylinder(p_loose=1.5), "p_loose: got 1.5, expected 0 to 1"),
        (lambda: shaken([]), "film: got [], expected one or more"),
        (lambda: shaken(sleeping_man(2), -1.0), "amount: got -1.0, expected 0 or more"),
        (lambda: turntable(2, (0, 5)), "size[0]: got 0, expected 1 or more"),
        (lambda: open_source(5), "source: got 5, expected a text or a Path"),
        (lambda: open_source("film.mp4", start="1"), "start: got '1', expected a whole number"),
        (lambda: read_points(None), "path: got None, expected a text or a Path"),
        (lambda: with_boxes(None, print), "frames: got None, expected an iterable"),
        (lambda: with_boxes([], 3), "detector: got 3, expected a function"),
        (lambda: Zone("a", CORNERS * NAN, (9, 9)), "polygon: got NaN or infinity"),
        (
            lambda: Zone("a", CORNERS[:2], (9, 9)),
            "polygon: got an array of float64 of shape (2, 2), expected 3",
        ),
        (lambda: Line("a", (1, 1), (1, 1)), "end: got (1, 1), which is the start"),
        (lambda: Zones(max_coast_time=-1.0), "max_coast_time: got -1.0, expected 0 or more"),
        (lambda: Watch(None), "zones: got None, expected a Zones"),
        (lambda: Watch(Zones()).update(NAN, 1, []), "time: got nan, expected a finite number"),
        (lambda: Watch(Zones()).update(0.0, 1, [5]), "sightings: got 5, expected Sighting"),
        (
            lambda: Watch(Zones()).update(0.0, 1, [Sighting(1, NAN, 0.0, 1.0, True)]),
            "sightings: got Sighting(identity=1, x=nan",
        ),
    ],
)
def test_one_line_names_what_is_wrong(call: Callable[[], object], words: str) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        call()
    assert str(caught.value).startswith(words)
    assert "\n" not in str(caught.value)
