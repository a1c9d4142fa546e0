"""CDnet's highway: foreground against its masks."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..evaluation.masks import PixelScore, total
from ..io.ground_truth import MaskTruth, read_ground_truth
from ..io.sources.open_source import open_source
from ..runs.progress import Progress
from .baselines import SETTINGS, CleanUp, Setting, readable_images, sweep_subtractors
from .compare import CHAINS, ModelSubtractor
from .datasets import data_folder
from .expectations import Expectation
from .experiment import Findings
from .record import Table

Image = NDArray[np.uint8]

MEDIAN = CleanUp(median=5)


def highway() -> Findings:
    """Foreground of CDnet's highway against its masks, raw and after a 5x5 median.

    Raises
    ------
    OSError
        if the sequence cannot be found.
    """
    folder = data_folder("cdnet-highway")
    truth = read_ground_truth(folder)
    assert isinstance(truth, MaskTruth)
    video = str(folder / "input")
    with open_source(video) as source:
        size, rate, n_frames = source.size, source.rate, source.n_frames
    settings = [
        Setting(name, "", partial(ModelSubtractor, engine, size, rate)) for name, engine in CHAINS
    ] + [
        each
        for each in SETTINGS
        if each.parameters in ("history 500, threshold 16", "history 500, threshold 400")
    ]
    lines: list[list[object]] = []
    measured: dict[tuple[str, int], float] = {}
    numbers = set(truth.frames)

    def evaluate(number: int, mask: Image) -> PixelScore:
        one = PixelScore()
        one.add(number, mask, truth.labels(number))
        return one

    with Progress("highway", (n_frames or 1700) * len(settings)) as progress:
        for row in sweep_subtractors(
            lambda: readable_images(str(folder / "input"), progress),
            numbers,
            evaluate,
            settings,
            (CleanUp(), MEDIAN),
        ):
            scores = total(row.values)
            measured[row.setting.method, row.clean_up.median] = scores.f_measure
            clean_up = "5x5 median" if row.clean_up.median else "raw"
            lines.append([row.setting.method, clean_up, scores.precision, scores.recall, scores.f_measure])
    expectations = [
        Expectation("F, raw", measured["RSMCM", 0], ">=", 0.93),
        Expectation("F, after a 5x5 median", measured["RSMCM", 5], ">=", 0.955),
    ]
    header = ("method", "clean-up", "precision", "recall", "F")
    return Findings("CDnet highway", [Table(header, lines)], expectations)
