"""CDnet's highway: foreground against its masks."""

from ..evaluation.masks import PixelScore
from ..io.ground_truth import MaskTruth, read_ground_truth
from ..io.sources.open_source import open_source
from ..runs.progress import Progress
from .baselines import CleanUp
from .compare import CHAINS, Model
from .datasets import data_folder
from .expectations import Expectation
from .experiment import Findings
from .record import Table

CLEAN_UPS = {"raw": CleanUp(), "5x5 median": CleanUp(median=5)}
HEADER = ("method", "clean-up", "precision", "recall", "F")


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
    with open_source(str(folder / "input")) as source, Progress("highway", source.n_frames) as progress:
        models = [Model(name, engine, source.size) for name, engine in CHAINS]
        scores = {(model.name, clean_up): PixelScore() for model in models for clean_up in CLEAN_UPS}
        for frame in source:
            for model in models:
                mask = model.step(frame).foreground
                if frame.image is not None and frame.number in truth:
                    for name, clean_up in CLEAN_UPS.items():
                        labels = truth.labels(frame.number)
                        scores[model.name, name].add(frame.number, clean_up.apply(mask), labels)
            progress.update()
    total = {key: score.total() for key, score in scores.items()}
    lines = [[*key, each.precision, each.recall, each.f_measure] for key, each in total.items()]
    expectations = [
        Expectation("F, raw", total["RSMCM", "raw"].f_measure, ">=", 0.93),
        Expectation("F, after a 5x5 median", total["RSMCM", "5x5 median"].f_measure, ">=", 0.955),
    ]
    return Findings("CDnet highway", [Table(HEADER, lines)], expectations)
