"""The body application over a film, with many seeds, beside joints that were clicked in its frames.

`python -m rsmcm.apps.experiments.body_film FILM JOINTS.csv --out FOLDER`
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import App, Parameter
from numpy.typing import NDArray

from ...chains.body.start import ClickedJoints
from ...models.body.upper_body import JOINTS
from ..body.application import run_body
from ..body.job import BodyJob
from ..body.joint_files import read_joints
from ..body.measures import APART, SOON, exchanged_hands, longest_exchange
from ..runs.parallel import chosen_workers, in_parallel, working
from .experiment import Findings, publish
from .record import Expectation, Table, over_seeds

Numbers = NDArray[np.float64]

HANDS, ELBOWS = (
    [JOINTS.index(f"{side}_{joint}") for side in ("left", "right")] for joint in ("hand", "elbow")
)

FAR = 50.0  # px: a hand is nowhere near

COLUMNS = (
    "seed", "hands, median px", f"hands over {FAR:g} px, %", "elbows, median px", "frames exchanged",
    "longest stretch of that",
)  # fmt: skip

app = App(name="body_film", help=__doc__.splitlines()[0])


@dataclass(frozen=True, eq=False)
class FilmTrial:
    """Errors of a run in the frames with clicked joints."""

    errors: Numbers  # `(n, 8)` px: distance of each joint in the picture; NaN where it was not noted
    exchanged: Numbers  # `(n,)` as of `exchanged_hands`
    longest: int  # frames of the film in the longest stretch with exchanged hands

    @classmethod
    def of(cls, poses: Mapping[str, Numbers], noted: ClickedJoints) -> "FilmTrial":
        """Compare the arrays of a `poses.npz` with joints.

        Raises
        ------
        ValueError
            if a frame is not among those that were tracked.
        """
        rows = np.searchsorted(poses["frames"], noted.frames)
        found = poses["frames"].take(rows, mode="clip") == noted.frames
        if not found.all():
            raise ValueError(f"{noted.path}: frame {noted.frames[~found][0]} is none of the film's")
        places = poses["joints_2d"][rows]
        lengths = dict(zip(poses["length_names"].tolist(), poses["lengths"].tolist(), strict=True))
        apart = APART * lengths["head_height"]
        exchanged = exchanged_hands(places[:, HANDS], noted.places[:, HANDS], apart)
        errors = np.linalg.norm(places - noted.places, axis=2)
        return cls(errors, exchanged, longest_exchange(noted.frames, exchanged))


@app.default
def main(
    film: Path,
    joints: Path,
    *,
    out: Path,
    seeds: int = 20,
    head: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    detector: Path | None = None,
    jobs: int | None = None,
) -> None:
    """Track the person with each seed, and compare.

    Parameters
    ----------
    film
        Any source of `rsmcm body`.
    joints
        CSV file with the columns frame,joint,x,y as of `rsmcm body --joints`; here it is the truth.
    out
        Folder for the page, and for the results of each run.
    seeds
        How many; from 0 on.
    head, detector
        As of `rsmcm body`.
    jobs
        Runs at once; as many as there are cores if not given.
    """
    noted = read_joints(joints)
    common = BodyJob(source=str(film), out=out, head=head, detector=detector, overwrite=True)
    runs = [replace(common, out=out / f"seed-{seed}", seed=seed) for seed in range(seeds)]
    with working(chosen_workers(jobs, None)):
        publish("body-film", f"body_film {film}", out, lambda: compared(runs, noted))


def compared(runs: Sequence[BodyJob], noted: ClickedJoints) -> Findings:
    """Carry out all runs, and compare them."""
    trials = in_parallel("seeds", [(tracked, (run, noted)) for run in runs])
    rows = [[run.seed, *cells_of(trial)] for run, trial in zip(runs, trials, strict=True)]
    caption = f"In {len(noted.frames)} frames of which joints were noted."
    return Findings(
        "Body on a film", [Table(COLUMNS, rows, caption)], over_seeds(expectations_of, {"trials": trials})
    )


def tracked(job: BodyJob, noted: ClickedJoints) -> FilmTrial:
    """Carry out one run."""
    run_body(job)
    with np.load(job.out / "poses.npz") as poses:
        return FilmTrial.of(poses, noted)


def cells_of(trial: FilmTrial) -> list[float | str]:
    """Return a run's cells of `COLUMNS`, after its seed."""
    hands, elbows = _finite(trial.errors[:, HANDS]), _finite(trial.errors[:, ELBOWS])
    values = [np.median(hands), 100 * (hands > FAR).mean()] if len(hands) else [np.nan] * 2
    values.append(np.median(elbows) if len(elbows) else np.nan)
    known = ["–" if np.isnan(value) else float(value) for value in values]
    return [*known, int(np.nansum(trial.exchanged)), trial.longest]


def expectations_of(by_name: Mapping[str, Sequence[FilmTrial]]) -> list[Expectation]:
    """Return what is expected over all seeds."""
    trials = by_name["trials"]
    hands = np.concatenate([_finite(trial.errors[:, HANDS]) for trial in trials])
    long = sum(trial.longest > SOON for trial in trials)
    return [
        Expectation("hands, median px", float(np.median(hands)), "<=", 15.0),
        Expectation(f"hands over {FAR:g} px, share", float((hands > FAR).mean()), "<=", 0.05),
        Expectation(f"seeds with hands exchanged for more than {SOON} frames", float(long), "<=", 0.0),
    ]


def _finite(errors: Numbers) -> Numbers:
    return errors[np.isfinite(errors)]


if __name__ == "__main__":
    try:
        app()
    except (ValueError, OSError) as error:
        print(f"body_film: {error}", file=sys.stderr)
        sys.exit(2)
