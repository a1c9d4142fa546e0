"""Algorithm 2 of the RSMCM paper, coordinate ascent over whole sequences, for any number of chains."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, nan
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from ...models.core.frame import Frame
from ..engine import checkpoint
from .graph import MultiChain, require_model
from .protocols import BatchChain, FeatureNode, MessageType, Named, Smoothed, TrajectoryType, name_of, require
from .sequence import LazyFrames, TimeSlices


@dataclass(frozen=True, eq=False)
class Round:
    """How far the ascent has come.

    Parameters
    ----------
    number
        1 for the first.
    objective
        sum over the chains of the log density of their trajectories, and over all features and frames of the
        log mass of the product of evidence and messages: the log of the model's density at the trajectories,
        with the features integrated out, as far as messages are the exact p(F | X). NaN where rounds are not
        compared.
    smoothed
        names of the chains that were worked out anew; a chain that would hear the same again is not.
    """

    number: int
    objective: float
    smoothed: tuple[str, ...]


class Solution:
    """Trajectories of all chains, and the beliefs over the features that go with them.

    `solution[chain]` is a chain's trajectory, `solution[feature]` the list of beliefs over a feature node,
    one for each frame.

    Attributes
    ----------
    frames
        the frames.
    rounds
        report of every round, the best of which this is.
    converged
        whether the ascent ended by itself and not at its wall.
    """

    def __init__(
        self, best: TimeSlices, latest: TimeSlices, rounds: tuple[Round, ...], converged: bool
    ) -> None:
        self.frames = best.frames
        self.rounds = rounds
        self.converged = converged
        self._slices = best
        self._latest = latest  # from which the ascent goes on

    def __repr__(self) -> str:
        how = "converged" if self.converged else "not converged"
        rounds = f"{len(self.frames)} frames, {len(self.rounds)} rounds, {how}"
        return f"Solution({rounds}: {self._slices.model.names})"

    @property
    def objective(self) -> float:
        """The highest that was reached."""
        return max(report.objective for report in self.rounds)

    @overload
    def __getitem__(self, key: BatchChain[TrajectoryType], /) -> TrajectoryType: ...
    @overload
    def __getitem__(self, key: FeatureNode[MessageType], /) -> list[MessageType]: ...
    @overload
    def __getitem__(self, key: str, /) -> Any: ...
    def __getitem__(self, key: Named | str, /) -> Any:
        name = name_of(key)
        if name in self._slices.trajectories:
            return self._slices.trajectories[name]
        if name in self._slices.model.features:
            return [self._slices.belief(name, time) for time in range(len(self.frames))]
        known = ", ".join([*self._slices.model.chains, *self._slices.model.features])
        raise KeyError(f"{name}: not part of the model, expected one of {known}")

    @overload
    def messages(self, chain: Named | str, feature: FeatureNode[MessageType]) -> Sequence[MessageType]: ...
    @overload
    def messages(self, chain: Named | str, feature: str) -> Sequence[Any]: ...
    def messages(self, chain: Named | str, feature: Named | str) -> Sequence[Any]:
        """What the chain says of the feature, for each frame, also where nobody hears it (no feedback)."""
        return self._slices.sent[name_of(chain), name_of(feature)]

    @overload
    def evidence(self, feature: FeatureNode[MessageType]) -> list[MessageType]: ...
    @overload
    def evidence(self, feature: str) -> list[Any]: ...
    def evidence(self, feature: Named | str) -> list[Any]:
        """What the frames say of the feature."""
        return [self._slices.evidence(name_of(feature), time) for time in range(len(self.frames))]


class CoordinateAscent:
    """Coordinate ascent (Algorithm 2): chain after chain gets its best trajectory, the others held fixed.

    Chains have their turn in the order of `MultiChain.chains`. The first round is the feed-forward pipeline:
    a chain hears only those before it. A chain that would hear the same again is left alone, so that a model
    without feedback needs one round. When chains approximate (a tracker that searches anew where others
    expect points may find other points), the objective can fall; the best round is what is kept.

    Parameters
    ----------
    model
        chains with `smooth` and `messages`, as they are now: later connections need a new engine.
    most_rounds
        wall on the number of rounds.
    tolerance
        share of the objective's size by which it has to rise for the ascent to go on; `None` for rounds that
        are not compared: the last one is taken, and the objective, which costs a pass over the film, is not
        worked out.

    Raises
    ------
    ValueError
        if the model has no chain or `most_rounds` is below 1.
    TypeError
        if one of the chains is none for batches.
    """

    def __init__(self, model: MultiChain, most_rounds: int = 20, tolerance: float | None = 1e-5) -> None:
        require_model(model)
        for name, chain in model.chains.items():
            require(f"chain {name!r}", chain, BatchChain)
        model.check_complete()
        if most_rounds < 1:
            raise ValueError(f"most_rounds: got {most_rounds}, expected 1 or more")
        self.model = model.copy()
        self.most_rounds = most_rounds
        self.tolerance = tolerance

    def __repr__(self) -> str:
        return f"CoordinateAscent({self.model})"

    def run(self, frames: Iterable[Frame | NDArray[np.uint8] | None], dt: float = 1 / 25) -> Solution:
        """Go on until the objective rises no more, or to the wall.

        Parameters
        ----------
        frames
            all of them; `Frame`s, or plain images `dt` seconds apart (`None` for a missing one), which are
            held. `LazyFrames` are not held but read again in every pass.
        dt
            seconds from one plain image to the next.

        Raises
        ------
        ValueError
            if there is no frame, they are not in order of time, or as a chain does.
        """
        *_, last = self.rounds(frames, dt)
        return last

    def rounds(
        self,
        frames: Iterable[Frame | NDArray[np.uint8] | None],
        dt: float = 1 / 25,
        after: Solution | None = None,
    ) -> Iterator[Solution]:
        """As `run`, with the best solution so far after every round.

        Parameters
        ----------
        frames, dt
            as of `run`.
        after
            to go on from, of the same frames (see `load`); what follows is as if it had never been left.
        """
        if after is None:
            best = slices = TimeSlices(self.model, _as_frames(frames, dt))
            reports: list[Round] = []
        else:
            best, slices, reports = after._slices, after._latest, list(after.rounds)
            if after.converged or len(reports) >= self.most_rounds:
                yield after
                return
        while True:
            slices = slices.copy()
            smoothed = slices.ascend()
            if not smoothed:
                yield Solution(best, slices, tuple(reports), converged=True)
                return
            objective = nan if self.tolerance is None else slices.objective()
            if self.tolerance is None or not reports or objective > max(each.objective for each in reports):
                best = slices
            reports.append(Round(len(reports) + 1, objective, smoothed))
            before = reports[-2].objective if len(reports) > 1 else -inf
            converged = self.tolerance is not None and objective < before + self.tolerance * abs(before)
            yield Solution(best, slices, tuple(reports), converged)
            if converged or len(reports) == self.most_rounds:
                return

    def save(self, path: str | Path, solution: Solution, about: Mapping[str, Any] | None = None) -> None:
        """Write how far the ascent has come to one `.npz` file: all of it, or none.

        Trajectories and evidence are saved; messages follow from them, and frames are not saved.

        Parameters
        ----------
        path
            of the file, which is replaced if it is there.
        solution
            as `rounds` gives it.
        about
            plain JSON to be kept with it.

        Raises
        ------
        TypeError
            if a trajectory or a message is not what the return annotation of `smooth` or `evidence` says.
        OSError
            if the file cannot be written; an older one is then left as it was.
        """
        same = solution._latest is solution._slices
        values = {
            "best": solution._slices.saved(),
            "latest": None if same else solution._latest.saved(),
            "rounds": solution.rounds,
            "converged": solution.converged,
            "about": dict(about or {}),
        }
        checkpoint.save(path, values, self._kinds())

    def load(
        self,
        file: str | Path | checkpoint.Contents,
        frames: Iterable[Frame | NDArray[np.uint8] | None],
        dt: float = 1 / 25,
    ) -> tuple[Solution, dict[str, Any]]:
        """Read back what `save` wrote, of the same frames: the solution, and `about`.

        Raises
        ------
        ValueError
            if the file is broken, of another version, of other chains or another number of frames.
        OSError
            if the file cannot be opened.
        """
        values = checkpoint.load(file, self._kinds())
        slices = _as_frames(frames, dt)
        best = TimeSlices.restored(self.model, slices, values["best"])
        latest = values["latest"]
        return (
            Solution(
                best,
                best if latest is None else TimeSlices.restored(self.model, slices, latest),
                values["rounds"],
                values["converged"],
            ),
            values["about"],
        )

    def _kinds(self) -> dict[str, Any]:
        def returned(method: Any) -> Any:
            hints = get_type_hints(method)
            if "return" not in hints:
                raise TypeError(f"{method.__qualname__}: no return annotation, which says what is saved")
            return hints["return"]

        def smoothed(method: Any) -> Any:
            kind = returned(method)
            if get_origin(kind) is not Smoothed:
                raise TypeError(f"{method.__qualname__}: returns {kind}, expected Smoothed[...]")
            return get_args(kind)[0]

        slices = {
            "trajectories": {name: smoothed(type(chain).smooth) for name, chain in self.model.chains.items()},
            "evidence": {
                name: list[returned(type(node).evidence) | None] | None  # type: ignore[misc]
                for name, node in self.model.features.items()
            },
            "found": {
                name: dict[str, list[returned(type(node).evidence)]]  # type: ignore[misc]
                for name, node in self.model.features.items()
            },
            "smoothed": dict[str, int],
            "read": dict[str, tuple[int, ...]],
        }
        return {
            "best": slices,
            "latest": slices,
            "rounds": tuple[Round, ...],
            "converged": bool,
            "about": dict[str, Any],
        }


def _as_frames(items: Iterable[Frame | NDArray[np.uint8] | None], dt: float) -> Sequence[Frame]:
    if isinstance(items, LazyFrames):
        return items
    frames = [
        item
        if isinstance(item, Frame)
        else Frame(None if item is None else np.asarray(item), index * dt, index + 1)
        for index, item in enumerate(items)
    ]
    if not frames:
        raise ValueError("frames: got none, expected at least one")
    for before, after in pairwise(frames):
        if not after.time > before.time:
            raise ValueError(
                f"frames: got time {after.time} s at frame {after.number}, "
                f"expected later than {before.time} s at frame {before.number}"
            )
    return frames
