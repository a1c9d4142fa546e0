"""Algorithm 1 of the RSMCM paper, recursive belief propagation, for any number of chains and features."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import inf
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from ...models.core.checks import (
    UNBOUNDED,
    Bound,
    Count,
    CountFrom0,
    NotNegative,
    Positive,
    SizesOf,
    checked,
)
from ...models.core.frame import Frame
from ...models.core.short_repr import html_table, short_repr
from ...models.numerics.threads import side_by_side
from . import checkpoint
from .graph import IMAGE, MultiChain, as_frame, require_frames, require_later, require_model
from .protocols import (
    BatchIncoming,
    Chain,
    FeatureNode,
    MessageType,
    Named,
    PerFrame,
    name_of,
    require,
)
from .time_slice import Sweeps, TimeSlice

State = TypeVar("State")
ImageShape = Annotated[tuple[int, ...], SizesOf("height", "width", "channels")]
BELOW_1 = Bound(lambda value: 0 <= value < 1, "0 to less than 1")


@short_repr
@dataclass(frozen=True, eq=False)
class RunState:
    """State of a run, from which it can continue: an immutable value that can be kept, saved and loaded.

    Parameters
    ----------
    states
        state of every chain by its name; empty before the first image.
    number, time
        of the last frame (1-based, seconds).
    shape
        of the images; `None` before the first one.
    """

    states: Mapping[str, Any] = field(default_factory=dict)
    number: int = 0
    time: float = -inf
    shape: tuple[int, ...] | None = None

    @staticmethod
    def kinds(chains: Mapping[str, Any]) -> dict[str, Any]:
        """Return the types of these chains' states by name, for `checkpoint`."""
        states = {}
        for name, chain in chains.items():
            hints = get_type_hints(chain.initial)
            if "return" not in hints:
                raise TypeError(f"chain {name!r}: initial has no return annotation, which says what is saved")
            states[name] = hints["return"]
        return {
            "shape": ImageShape | None,
            "states": states,
            "number": CountFrom0,
            "time": Annotated[float, UNBOUNDED],
        }

    def saved(self) -> dict[str, Any]:
        """Return the state as a record of these kinds."""
        return {
            "shape": self.shape,
            "states": dict(self.states) or None,
            "number": self.number,
            "time": self.time,
        }

    @classmethod
    def restored(cls, saved: Mapping[str, Any]) -> "RunState":
        """Return the state that `saved` describes."""
        return cls(**{**saved, "states": saved["states"] or {}})


class Belief:
    """Posterior after a frame.

    `belief[chain]` or `belief["name"]` is the posterior state of a chain, `belief[feature]` or
    `belief["name"]` the product of all messages that reach a feature node. While all frames are missing there
    is no belief, and access is a `KeyError`.

    Attributes
    ----------
    frame
        the frame.
    state
        from which the run can continue.
    """

    def __init__(self, frame: Frame, state: RunState, time_slice: TimeSlice | None) -> None:
        self.frame = frame
        self.state = state
        self._slice = time_slice

    def __repr__(self) -> str:
        missing = ", missing" if self.frame.missing else ""
        names = "nothing yet" if self._slice is None else self._slice.model.names
        settled = "" if self.converged else f", not settled after {self.sweeps} sweeps"
        return f"Belief(frame {self.frame.number} at {self.frame.time:.6g} s{missing}{settled}: {names})"

    def _repr_html_(self) -> str:
        """Posterior states of the chains, for notebooks."""
        return html_table(repr(self), ("chain", "state"), self.states.items())

    @property
    def states(self) -> Mapping[str, Any]:
        """Posterior states of the chains by name."""
        return self.state.states

    @property
    def converged(self) -> bool:
        """Whether the messages of all loops have settled; true without loops."""
        return self._slice is None or self._slice.converged

    @property
    def sweeps(self) -> int:
        """Number of sweeps of the loop that needed most; 1 without loops."""
        return 1 if self._slice is None else self._slice.sweeps

    @cached_property
    def log_evidence(self) -> float:
        """log p(I_t | I_1..t-1), computed on demand; 0 before the first image.

        At each feature with messages, it is the log of the integral of the product with the image minus that
        without it, so it does not depend on the scale of messages. Features that share a chain are
        conditioned on earlier ones; a component that reads another one through a cut edge is conditioned on
        it. It is exact except for approximations of the chains. For a component with a loop it is the Bethe
        approximation, for which messages are sent once more in sweeps without the image (`converged` does not
        include these).
        """
        return 0.0 if self._slice is None else self._slice.log_evidence()

    def message(self, chain: Named | str, feature: FeatureNode[MessageType]) -> MessageType:
        """Return the chain's message to the feature; a `KeyError` if there is none."""
        return self._sent(name_of(chain), feature)

    def evidence(self, feature: FeatureNode[MessageType]) -> MessageType:
        """Return the evidence at the feature, uniform in a missing frame; a `KeyError` without a belief."""
        return feature.uniform() if self.frame.missing else self._sent(IMAGE, feature)

    def _sent(self, sender: str, feature: FeatureNode[MessageType]) -> MessageType:
        if self._slice is None:
            raise KeyError(f"{feature.name}: there is no message before the first frame that is not missing")
        message: MessageType = self._slice.sent(sender, feature.name)
        return message

    @overload
    def __getitem__(self, key: Chain[State], /) -> State: ...
    @overload
    def __getitem__(self, key: FeatureNode[MessageType], /) -> MessageType: ...
    @overload
    def __getitem__(self, key: str, /) -> Any: ...
    def __getitem__(self, key: Named | str, /) -> object:
        name = name_of(key)
        if self._slice is None:
            raise KeyError(f"{name}: there is no belief before the first frame that is not missing")
        if name in self.state.states:
            return self.state.states[name]
        if name in self._slice.model.features:
            return self._slice.product(name)
        raise self._slice.model.unknown(name)


class RecursiveBP:
    """Recursive belief propagation (Algorithm 1): predict, exchange messages, update, frame by frame.

    The marginals of the chains after a frame are the priors of the next; within a frame sum-product runs on
    the graph of chains and features. On a forest every message is sent once, which is exact as far as the
    messages are. Messages of a loop (`MultiChain.has_loops`) are sent in sweeps until they settle: loopy
    belief propagation, whose marginals are approximate. See `Belief.converged`, and `SettlingMessage` for
    what messages can offer.

    Parameters
    ----------
    model
        its later connections need a new engine.
    damping
        exponent of the old message of a loop in the new one, 0 to less than 1. More damping settles slower,
        but in more cases. Messages without powers are not damped.
    most_sweeps
        greatest number of sweeps in a frame.
    tolerance
        largest distance of messages from those of the last sweep at which a loop has settled.

    Raises
    ------
    ValueError
        if the model has no chain, or a parameter is out of range.
    TypeError
        if one of the chains cannot filter.
    """

    @checked
    def __init__(
        self,
        model: MultiChain,
        damping: Annotated[float, BELOW_1] = 0.0,
        most_sweeps: Count = 50,
        tolerance: NotNegative = 1e-6,
    ) -> None:
        require_model(model)
        for name, chain in model.chains.items():
            require(f"chain {name!r}", chain, Chain)
        model.check_complete()
        self.model = model.copy()
        self._schedule = self.model.schedule()
        self._sweeps = Sweeps(damping, most_sweeps, tolerance)

    def __repr__(self) -> str:
        return f"RecursiveBP({self.model})"

    @checked
    def step(self, state: RunState, frame: Frame) -> Belief:
        """Filter one frame.

        The first frame with an image or points uses the initial states of the chains, later ones their
        predictions. A missing frame brings no evidence: chains predict and exchange messages.

        Parameters
        ----------
        state
            of the run until now, which is not changed; `RunState()` at the beginning.
        frame
            the next frame.

        Raises
        ------
        ValueError
            if the frame is not later than the last one or has another size, or if `state` belongs to other
            chains.
        TypeError
            if a chain returns a wrong message or no state.
        """
        shape = state.shape if frame.image is None else frame.image.shape
        require_later(frame, state.time, state.number)
        if state.shape is not None and shape != state.shape:
            raise ValueError(
                f"frames: got {shape} uint8 at frame {frame.number}, expected {state.shape} uint8"
            )
        if not state.states and frame.image is None and frame.points is None:
            # boxes alone are nothing that chains could start from
            return Belief(replace(frame, boxes=None), RunState({}, frame.number, frame.time, None), None)

        chains = self.model.chains
        if not state.states:
            predictions = {name: chain.initial(frame) for name, chain in chains.items()}
        elif state.states.keys() == chains.keys():
            dt = frame.time - state.time
            predictions = {name: chain.predict(state.states[name], dt) for name, chain in chains.items()}
            _require_states("predict", state.states, predictions)
        else:
            raise ValueError(f"state: got chains {', '.join(state.states)}, expected {', '.join(chains)}")
        time_slice = TimeSlice(self.model, predictions, frame, self._schedule, self._sweeps)
        time_slice.exchange()
        incoming = {name: time_slice.incoming(name) for name in chains}
        updated = side_by_side(
            [partial(chain.update, predictions[name], incoming[name]) for name, chain in chains.items()]
        )
        states = dict(zip(chains, updated, strict=True))
        _require_states("update", predictions, states)
        return Belief(frame, RunState(states, frame.number, frame.time, shape), time_slice)

    @checked
    def run(
        self,
        frames: Iterable[Frame | NDArray[np.uint8] | None],
        dt: Positive = 1 / 25,
        state: RunState | None = None,
    ) -> Iterator[Belief]:
        """Filter frames one after the other, and yield the belief after each.

        Parameters
        ----------
        frames
            `Frame`s, or plain images `dt` seconds apart (`None` for a missing one).
        dt
            seconds from one plain image to the next.
        state
            to continue from; by default from the beginning.

        Raises
        ------
        ValueError
            as `step` does, or if something is not an image, or `dt` not positive.
        TypeError
            if `frames` is a single image.
        """
        require_frames(frames)
        return self._run(frames, dt, state or RunState())

    def _run(
        self, frames: Iterable[Frame | NDArray[np.uint8] | None], dt: float, state: RunState
    ) -> Iterator[Belief]:
        for item in frames:
            time = state.time + dt if state.time > -inf else 0.0
            belief = self.step(state, as_frame(item, time, state.number + 1))
            state = belief.state
            yield belief

    @checked
    def save(self, path: str | Path, state: RunState, about: Mapping[str, Any] | None = None) -> None:
        """Save the state of a run and `about`, plain JSON, to an `.npz` file, completely or not at all.

        Raises
        ------
        TypeError
            if a chain's state is not what the return annotation of its `initial` says.
        OSError
            if the file cannot be written; an older one is then left as it was.
        """
        values = {**state.saved(), "parameters": self.model.parameters(), "about": dict(about or {})}
        checkpoint.save(path, values, self._kinds())

    @checked
    def load(self, path: str | Path) -> tuple[RunState, dict[str, Any]]:
        """Load what `save` wrote: the state of the run, and `about`.

        Raises
        ------
        ValueError
            if the file is broken, of another version, or of a model with other chains or parameters.
        OSError
            if the file cannot be opened.
        """
        contents = checkpoint.read(path)
        checkpoint.require_same(contents.path, contents.plain("parameters"), self.model.parameters())
        values = checkpoint.load(contents, self._kinds())
        about = values.pop("about")
        del values["parameters"]
        return RunState.restored(values), about

    def _kinds(self) -> dict[str, Any]:
        plain = {"parameters": dict[str, Any], "about": dict[str, Any]}
        return {**RunState.kinds(self.model.chains), **plain}


def _require_states(method: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
    """Raise a `TypeError` where a chain gave no state, for want of a `return`."""
    for name, state in after.items():
        if state is None and before[name] is not None:
            raise TypeError(f"chain {name!r}: {method} gave None, expected a state")


class ForwardPass(PerFrame[MessageType]):
    """Messages of a filter, one a frame, computed on demand.

    In order of time, a frame costs one step of the filter; for an earlier frame it starts again. It holds one
    state and one belief, however long the sequence is.

    Parameters
    ----------
    engine, start
        the filter, and its state before the first frame.
    incoming_over_time
        whose frames it filters.
    read
        the message in a frame, given the belief after it.
    """

    def __init__(
        self,
        engine: RecursiveBP,
        start: RunState,
        incoming_over_time: Sequence[BatchIncoming],
        read: Callable[[Belief], MessageType],
    ) -> None:
        self._engine = engine
        self._start = start
        self._incoming = incoming_over_time
        self._read = read
        self._state = start
        self._next = 0
        self._belief: Belief

    def __len__(self) -> int:
        return len(self._incoming)

    def _at(self, number: int) -> MessageType:
        if number < self._next - 1:
            self._state, self._next = self._start, 0
        while self._next <= number:
            self._belief = self._engine.step(self._state, self._incoming[self._next].frame)
            self._state = self._belief.state
            self._next += 1
        return self._read(self._belief)
