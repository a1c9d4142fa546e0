"""Which parameters are tried, how well they do on films with truth, and the best that optuna finds."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from ..background.parameters import Parameters, with_defaults
from ..experiments.films import BOXES, FEEDBACK, TrueFilm, score
from ..experiments.pets import DETECTED
from ..options.libraries import needed

SEARCHED: Mapping[str, Sequence[str]] = {
    "background": ("noise", "settle_time"),
    "blobs": (
        "min_area",
        "strength",
        "likelihood_power",
        "acceleration",
        "max_coast_time",
        "max_hidden_time",
        "confirmation_time",
        "ghost_threshold",
    ),
}
"""Parameters that are varied, by section: positive numbers on which masks and tracks depend most."""

FACTOR = 4.0
"""They are varied from a quarter of where the search begins to four times that, on a logarithmic scale."""

STUDY = "study.log"
"""optuna's journal of all trials."""

Values = dict[str, float]
"""Searched parameters by `section.name`."""


@dataclass(frozen=True)
class Task:
    """Films on which parameters are tried, all with the same kind of truth.

    `start` are the parameters where the search begins, and with which its result is compared; `seeds` is the
    number of seeds of noise of a film, 0 for films as they are.
    """

    films: Sequence[TrueFilm]
    start: Parameters
    seeds: int = 0
    _known: dict[tuple[str, str], float] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def method(self) -> str:
        """With the boxes of the detector, where all films have some."""
        has_boxes = all(film.kind is BOXES and film.detections.exists() for film in self.films)
        return DETECTED if has_boxes else FEEDBACK

    @cached_property
    def measure(self) -> str:
        """F of masks, HOTA of tracks."""
        return self.films[0].kind.measures[0]

    @cached_property
    def begin(self) -> Values:
        """Values of the searched parameters at the start."""
        complete = with_defaults(self.start)
        known = {f"{section}.{name}": (section, name) for section in SEARCHED for name in SEARCHED[section]}
        return {key: complete[section][name] for key, (section, name) in known.items()}

    def parameters(self, values: Values) -> dict[str, Any]:
        """Those of the start with other values of the searched ones."""
        sections = {section: dict(given) for section, given in self.start.items()}
        for key, value in values.items():
            section, name = key.split(".")
            sections.setdefault(section, {})[name] = value
        return sections

    def value(self, film: TrueFilm, values: Values) -> float:
        """The measure of a film, mean over the seeds.

        It is a ValueError or OSError if something is wrong with the film, or it has no such measure.
        """
        key = (film.name, json.dumps(values, sort_keys=True))
        if key not in self._known:
            parameters = self.parameters(values)
            seeds = range(self.seeds) if self.seeds else (None,)
            scores = [score(film, self.method, seed, parameters)[self.measure] for seed in seeds]
            if not np.isfinite(scores).all():
                raise ValueError(f"{film.folder}: its {self.measure} is not defined")
            self._known[key] = float(np.mean(scores))
        return self._known[key]


@dataclass(frozen=True)
class Found:
    """The best parameters of a search, its number of trials, and the share of each parameter in the spread.

    The shares are of the measure over the trials (optuna's PED-ANOVA: S. Watanabe, A. Bansal, F. Hutter,
    *PED-ANOVA*, IJCAI 2023); empty where there are fewer trials than `LEAST`.
    """

    values: Values
    trials: int
    shares: Values


LEAST = 20
"""Trials from which shares are told."""


def search(
    task: Task, films: Sequence[TrueFilm], seconds: float, out: Path, told: Callable[[], None]
) -> Found:
    """Try parameters on films for some seconds, after those of the start; what was tried earlier counts too.

    Trials are in the journal of the folder `out`, by a digest of films and start, so that the same search
    goes on. `told` is called after each trial. Errors are those of `Task.value`, and an ImportError without
    optuna.
    """
    optuna = needed("optuna", "tune")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    about = [[film.known_by() for film in films], with_defaults(task.start), task.method, task.seeds]
    journal = optuna.storages.journal.JournalFileBackend(str(out / STUDY))
    study = optuna.create_study(
        storage=optuna.storages.JournalStorage(journal),
        study_name=sha256(json.dumps(about, default=str).encode()).hexdigest()[:16],
        sampler=optuna.samplers.TPESampler(seed=0, multivariate=True),
        direction="maximize",
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(task.begin)

    def tried(trial: Any) -> float:
        values = {
            key: trial.suggest_float(key, value / FACTOR, value * FACTOR, log=True)
            for key, value in task.begin.items()
        }
        return float(np.mean([task.value(film, values) for film in films]))

    study.optimize(tried, timeout=seconds, callbacks=[lambda *_: told()])
    done = [trial for trial in study.trials if trial.value is not None]
    shares: Values = {}
    if len(done) >= LEAST:
        importance = optuna.importance
        evaluator = importance.PedAnovaImportanceEvaluator()
        shares = importance.get_param_importances(study, evaluator=evaluator)
    return Found(dict(study.best_params), len(done), shares)
