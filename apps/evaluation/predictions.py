"""Predictions of chains for their common features, recorded in `predictions.npz` during a run.

For every pair of chains and feature: both predictions of each point (or part, or box), made before it was
observed, and what was then observed; or, where predictions are no Gaussians, the log densities that they gave
to what was then observed. `rsmcm validity` judges from it which chains help each other.
"""

import base64
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inference.validity import RecordedPredictions
from ...models.array_files import read_arrays
from ...models.core.gaussian_message import GaussianMessage
from ...models.core.identities import places_of
from ...models.files import write_atomically
from ...models.numerics.evenly_spaced import evenly_spaced

FILE = "predictions.npz"
FORMAT = "rsmcm predictions 1"
EXPECTED = "expected the predictions of a run"
MOST_ROWS = 50_000  # of a pair in a file: some 10 MB
LARGEST, LEAST_VARIANCE = 1e14, 1e-14
"""Of what is recorded: squares of px that no picture has."""

SAVED = {"every": int, "offered": int, "frames": list[tuple[int, str, str, str, str, str, str, str]]}
"""Kinds of what `PairRecorder.saved` returns."""

NAMES = ("first", "second", "feature", "unit")


@dataclass(frozen=True, eq=False)
class _Pair:
    first: str
    second: str
    feature: str  # what both chains predict
    unit: str  # of the feature, such as "px"; of scores what a row is of, such as "a pixel"


@dataclass(frozen=True, eq=False)
class PairRecord(_Pair):
    """Predictions of one pair of chains."""

    predictions: RecordedPredictions  # n of them
    tracks: NDArray[np.int64]  # `(n,)`, of which point, part or object
    frames: NDArray[np.int64]  # `(n,)`, numbers of the frames

    def rows(self, kept: NDArray[np.int64]) -> "PairRecord":
        """Return some of the rows."""
        predictions = self.predictions.rows(kept)
        return replace(self, predictions=predictions, tracks=self.tracks[kept], frames=self.frames[kept])


@dataclass(frozen=True, eq=False)
class ScoreRecord(_Pair):
    """Log densities that a pair of chains and their product gave to what was observed."""

    scores: NDArray[np.float64]  # `(n, 3)` nats: of the first chain, the second, and their product
    frames: NDArray[np.int64]  # `(n,)`, numbers of the frames

    def rows(self, kept: NDArray[np.int64]) -> "ScoreRecord":
        """Return some of the rows."""
        return replace(self, scores=self.scores[kept], frames=self.frames[kept])


Record = PairRecord | ScoreRecord


@dataclass(eq=False)
class PairRecorder:
    """Recorder of the messages of two chains about a feature of many points, frame by frame.

    Memory is bounded: when there are more than `most` rows, every other frame is dropped, and from then on
    frames are taken half as often.

    `most` rows are two files' worth if not given.
    """

    first: str
    second: str
    feature: str
    unit: str = "px"
    most: int = 2 * MOST_ROWS
    _frames: list[tuple[int, NDArray[np.int64], list[NDArray[np.float64]]]] = field(default_factory=list)
    _every: int = 1
    _offered: int = 0

    def add(
        self, number: int, first: GaussianMessage, second: GaussianMessage, evidence: GaussianMessage
    ) -> None:
        """Record a frame: both chains' predictions, made before it, and the evidence of the image.

        Points that not all three speak of are left out.
        """
        self._offered += 1
        if (self._offered - 1) % self._every:
            return
        messages = [message.moments for message in (first, second, evidence)]
        common = np.intersect1d(np.intersect1d(messages[0][0], messages[1][0]), messages[2][0])
        if not len(common):
            return
        arrays = []
        for identities, means, covariances in messages:
            place = places_of(identities, common)
            arrays += [means[place], covariances[place]]
        self._frames.append((number, common, arrays))
        if sum(len(identities) for _, identities, _ in self._frames) > self.most:
            self._frames = self._frames[::2]
            self._every *= 2

    def saved(self) -> dict[str, Any]:
        """Return the state as plain JSON; arrays in base 64."""
        frames = [
            (number, *(_encoded(array) for array in (identities, *arrays)))
            for number, identities, arrays in self._frames
        ]
        return {"every": self._every, "offered": self._offered, "frames": frames}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Set the state that `saved` returned."""
        self._every, self._offered, self._frames = saved["every"], saved["offered"], []
        for number, *encoded in saved["frames"]:
            identities, *arrays = map(_decoded, encoded)
            self._frames.append((number, identities.astype(np.int64), arrays))

    def record(self) -> PairRecord | None:
        """Return all recorded rows; `None` if no frame had a common point."""
        if not self._frames:
            return None
        first, of_first, second, of_second, observed, noise = (
            np.concatenate(parts) for parts in zip(*(arrays for _, _, arrays in self._frames), strict=True)
        )
        return PairRecord(
            self.first,
            self.second,
            self.feature,
            self.unit,
            RecordedPredictions(first, second, observed, noise, of_first, of_second),
            np.concatenate([identities for _, identities, _ in self._frames]),
            np.concatenate([np.full(len(identities), number) for number, identities, _ in self._frames]),
        )


def _encoded(array: NDArray[Any]) -> str:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return base64.b64encode(stream.getvalue()).decode()


def _decoded(text: str) -> NDArray[Any]:
    array: NDArray[Any] = np.load(io.BytesIO(base64.b64decode(text)), allow_pickle=False)
    return array


def write_predictions(folder: Path, records: Sequence[Record]) -> None:
    """Write `predictions.npz`, at most `MOST_ROWS` rows of each pair, evenly chosen; whole or not at all.

    Raises
    ------
    OSError
        if the file cannot be written.
    """
    members: dict[str, NDArray[Any]] = {}
    names: list[dict[str, str]] = []
    for number, record in enumerate(records):
        count = len(record.frames)
        thin = record if count <= MOST_ROWS else record.rows(np.array(evenly_spaced(count, MOST_ROWS)))
        arrays: dict[str, Any] = {"frames": thin.frames}
        if isinstance(thin, ScoreRecord):
            arrays["scores"] = thin.scores
        else:
            arrays["tracks"] = thin.tracks
            arrays |= {
                part.name: getattr(thin.predictions, part.name) for part in fields(RecordedPredictions)
            }
        members |= {f"{number}/{name}": array for name, array in arrays.items() if array is not None}
        names.append({name: getattr(record, name) for name in NAMES})
    about = np.array(json.dumps({"format": FORMAT, "pairs": names}))
    with write_atomically(folder / FILE) as unfinished, unfinished.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, about=about, **members)


def read_predictions(folder: Path) -> list[Record]:
    """Read what `write_predictions` wrote.

    Raises
    ------
    ValueError
        in one line that names the file, if it is broken or holds other things.
    OSError
        if the file cannot be opened.
    """
    path = folder / FILE
    arrays = read_arrays(path, EXPECTED)
    try:
        about = json.loads(str(arrays.pop("about")))
        found, names = about["format"], about["pairs"]
    except (KeyError, TypeError, ValueError, RecursionError):
        raise ValueError(f"{path}: got other arrays than predictions, {EXPECTED}") from None
    if found != FORMAT:
        raise ValueError(f"{path}: got format {str(found)[:60]!r}, expected {FORMAT!r}")
    try:
        return [
            (_scores if f"{number}/scores" in arrays else _record)(arrays, number, pair)
            for number, pair in enumerate(names)
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def _scores(arrays: dict[str, NDArray[Any]], number: int, names: dict[str, str]) -> ScoreRecord:
    scores, frames = arrays[f"{number}/scores"], arrays[f"{number}/frames"]
    if scores.dtype.kind not in "iuf" or not (np.abs(scores) <= LARGEST).all():
        raise ValueError(f"pair {number}, scores: got {scores.dtype}, expected numbers up to {LARGEST:g}")
    if scores.ndim != 2 or scores.shape[1] != 3 or frames.shape != scores.shape[:1]:
        raise ValueError(
            f"pair {number}: got scores {scores.shape} of frames {frames.shape}, expected (n, 3) and (n,)"
        )
    first, second, feature, unit = (str(names[name]) for name in NAMES)
    return ScoreRecord(first, second, feature, unit, scores.astype(np.float64), frames)


def _record(arrays: dict[str, NDArray[Any]], number: int, names: dict[str, str]) -> PairRecord:
    optional = ("first_covariance", "second_covariance")
    parts = {
        part.name: arrays.get(f"{number}/{part.name}")
        if part.name in optional
        else arrays[f"{number}/{part.name}"]
        for part in fields(RecordedPredictions)
    }
    for name, part in parts.items():
        if part is not None and (part.dtype.kind not in "iuf" or (np.abs(part) > LARGEST).any()):
            raise ValueError(f"pair {number}, {name}: got {part.dtype}, expected numbers up to {LARGEST:g}")
    predictions = RecordedPredictions(**parts)  # type: ignore[arg-type]
    for name in ("noise", *optional):
        stated = getattr(predictions, name)
        if stated is not None and np.linalg.eigvalsh(stated).min() < LEAST_VARIANCE:
            raise ValueError(f"pair {number}, {name}: got less than {LEAST_VARIANCE:g}, expected more")
    tracks, frames = arrays[f"{number}/tracks"], arrays[f"{number}/frames"]
    if not tracks.shape == frames.shape == (len(predictions),):
        raise ValueError(
            f"pair {number}: got {tracks.shape} tracks and {frames.shape} frames "
            f"for {len(predictions)} predictions"
        )
    first, second, feature, unit = (str(names[name]) for name in NAMES)
    return PairRecord(first, second, feature, unit, predictions, tracks, frames)
