"""Messages of one frame, their products, and the evidence that follows from them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isnan
from typing import Any

from ...models.core.frame import Frame
from .graph import IMAGE, MultiChain, Step, naming_message
from .protocols import Cavity, Incoming, Message, Named, Results


@dataclass(eq=False)
class Sent:
    """A message, computed from the factors `incoming` by feature when it is first multiplied."""

    sender: str
    feature: str
    incoming: Mapping[str, "Factors"]
    message: Any = None
    is_damped: bool = False


Factors = tuple[Sent, ...]


@dataclass(frozen=True)
class Sweeps:
    """Limits of the sweeps over a loop; see `RecursiveBP`."""

    damping: float
    most: int
    tolerance: float


class TimeSlice:
    """Messages of one frame, and their products.

    The same factors always give the same product object, so that messages may keep what they work out. No
    message refers to the slice, so that large arrays go with it.

    Attributes
    ----------
    sweeps
        how often the messages of a loop were sent, the largest number of all loops; 1 without loops.
    converged
        whether the messages of all loops have settled.
    """

    def __init__(
        self,
        model: MultiChain,
        predictions: Mapping[str, Any],
        frame: Frame,
        schedule: Sequence[tuple[Step, ...]],
        limits: Sweeps,
    ) -> None:
        self.model = model
        self.predictions = predictions
        self.frame = frame
        self.schedule = schedule
        self.limits = limits
        self.sweeps = 1
        self.converged = True
        self._results: Results = {}
        self._sent: dict[Step, Sent] = {}
        self._products: dict[tuple[str, Factors], Any] = {}

    def exchange(self) -> None:
        """Send all messages: in the order of the schedule, those of a loop again until they settle."""
        for group in self.schedule:
            if len(group) == 1:
                self._send(*group[0])
            else:
                self._settle(group)

    def incoming(self, chain: str) -> Incoming:
        """Return the messages that reach the chain, without its own, computed."""
        factors = {name: self._factors(name, chain) for name in self.model.features_of[chain]}
        for feature, those in factors.items():
            self._multiply(feature, those)
        return _Incoming(self, factors)

    def sent(self, sender: str, feature: str) -> Any:
        """Return the message of a chain, or of the image, to the feature; a `KeyError` if there is none."""
        if (sender, feature) not in self._sent:
            raise KeyError(f"{sender!r} sends nothing to {feature!r}")
        return self._message(self._sent[sender, feature])

    def product(self, feature: str) -> Any:
        """Return the product of all messages to the feature."""
        return self._multiply(feature, self._factors(feature))

    def log_evidence(self) -> float:
        """Return log p(image | past).

        By the chain rule, that of each feature given those before it; where features form a loop, by the
        difference of two Bethe free energies, with the image and without it.
        """
        in_loops = {feature for group in self.schedule if len(group) > 1 for _, feature in group}
        total = 0.0
        for features in self.model.components():
            if in_loops.isdisjoint(features):
                total += sum(
                    self._log_evidence_at(feature, features[:number])
                    for number, feature in enumerate(features)
                )
            elif any((IMAGE, feature) in self._sent for feature in features):
                unseen = _WithoutImage(self, features)
                unseen.exchange()
                log_sum = self.bethe(features)
                total += log_sum - unseen.bethe(features) if log_sum > -inf else -inf
        return float(total)

    def bethe(self, features: Sequence[str]) -> float:
        """Return Bethe's log of the sum over all states of the chains and values of these features.

        Yedidia, Freeman, Weiss: *Constructing free-energy approximations and generalized belief propagation
        algorithms* (2005). With Z_f = mass of the belief at feature f with d_f chains, and Z_c = sum over
        the states of chain c of its prediction times all that reaches it, it is sum_c log Z_c + sum_f (1 -
        d_f) log Z_f. Z_c follows by the chain rule, feature by feature, so that no message's scale matters.
        """
        terms = [
            (self.product(feature).log_mass, 1.0 - len(self.model.senders[feature])) for feature in features
        ]
        chains = {name for feature in features for name in self.model.senders[feature]}
        for chain in sorted(chains):
            own = [feature for feature in features if chain in self.model.senders[feature]]
            for number, feature in enumerate(own):
                incoming = {**self._incoming_of(chain, feature), **dict.fromkeys(own[number + 1 :], ())}
                # what it finds in its own cavity decides where it speaks, now as before
                incoming[feature] = self._sent[chain, feature].incoming[feature]
                message = Sent(chain, feature, incoming)
                reaches = self._factors(feature, chain)
                terms.append((self._multiply(feature, (*reaches, message)).log_mass, 1.0))
                terms.append((self._message(message).log_mass, -1.0))
        if any(log_mass == -inf for log_mass, _ in terms):
            return -inf
        return float(sum(count * log_mass for log_mass, count in terms if count))

    def _send(self, sender: str, feature: str) -> None:
        """Send a message that follows from what has been sent by now."""
        if sender == IMAGE:
            if self.frame.missing:
                return
            incoming = {feature: self._ahead(feature) if self.model.features[feature].searches else ()}
        else:
            incoming = self._incoming_of(sender, feature)
        self._sent[sender, feature] = Sent(sender, feature, incoming)

    def _incoming_of(self, chain: str, feature: str) -> dict[str, Factors]:
        """Factors on which a chain's message to a feature depends; at that feature, see `Cavity`."""
        incoming = {name: self._factors(name, chain) for name in self.model.features_of[chain]}
        before = self._sent.get((chain, feature))
        if before is not None:  # in a loop: those that spoke before it at first
            incoming[feature] = self._present((sent.sender, feature) for sent in before.incoming[feature])
        elif self.model.cavities[chain, feature] != Cavity.OTHERS:
            wanted = self.model.cavities[chain, feature] == Cavity.IMAGE
            incoming[feature] = self._present([(IMAGE, feature)] if wanted else [])
        return incoming

    def _settle(self, steps: Sequence[Step]) -> None:
        """Send the messages of a loop again and again until they settle."""
        for number in range(1, self.limits.most + 1):
            before = list(self._sent.values())
            change = max([self._send_again(step) for step in steps])
            self._forget(set(before) - set(self._sent.values()))
            self.sweeps = max(self.sweeps, number)
            if change <= self.limits.tolerance:
                return
        self.converged = False

    def _send_again(self, step: Step) -> float:
        """Send a message of a loop, and return by how much it differs from the one before."""
        before = self._sent.get(step)
        incoming = self._incoming_of(*step)
        if before is not None and before.incoming == incoming and not before.is_damped:
            return 0.0
        sent = Sent(*step, incoming)
        message = self._message(sent)
        if hasattr(message, "normalised"):
            sent.message = message.normalised()
        if before is None:
            self._sent[step] = sent
            return inf
        change = self._change(before, sent)
        if change == 0:
            sent.message = before.message  # so that what was worked out with it stays
        elif self.limits.damping and hasattr(message, "__pow__"):
            damping = self.limits.damping
            sent.message = sent.message ** (1 - damping) * before.message**damping
            sent.is_damped = True
        if change > 0:
            self._sent[step] = sent
        else:
            before.incoming, before.is_damped = incoming, False
        return change

    def _change(self, before: Sent, after: Sent) -> float:
        if hasattr(after.message, "distance"):
            return float(after.message.distance(before.message))
        others = self._factors(after.feature, after.sender)
        masses = [self._multiply(after.feature, (*others, sent)).log_mass for sent in (before, after)]
        return 0.0 if masses[0] == masses[1] else abs(masses[1] - masses[0])

    def _forget(self, replaced: set[Sent]) -> None:
        """Drop what was computed from messages that have been replaced."""
        old = [key for key in self._products if not replaced.isdisjoint(key[1])]
        gone = [*(sent.message for sent in replaced), *(self._products.pop(key) for key in old)]
        for sent in replaced:
            sent.incoming = {}
        ids = set(map(id, gone))
        for key, (arguments, result) in list(self._results.items()):
            if not ids.isdisjoint(map(id, arguments)):
                gone.append(result)
                ids.add(id(result))
                del self._results[key]

    def _log_evidence_at(self, feature: str, seen: Sequence[str]) -> float:
        """Log probability of what the image shows of a feature, given what it shows of those `seen`."""
        if (IMAGE, feature) not in self._sent:
            return 0.0
        predicted = tuple(self._given(name, feature, seen) for name in self.model.senders[feature])
        log_mass = self._multiply(feature, (self._sent[IMAGE, feature], *predicted)).log_mass
        if isnan(log_mass):
            senders = ", ".join(self.model.senders[feature])
            raise ValueError(f"log evidence at {feature!r}: got NaN from {senders}, expected a number")
        return float(log_mass - self._multiply(feature, predicted).log_mass) if log_mass > -inf else -inf

    def _given(self, chain: str, feature: str, seen: Sequence[str]) -> Sent:
        """The chain's message if the image showed only those features of its component that are `seen`.

        What it found in its own cavity, and what it reads through cut edges, stays as it is.
        """
        sent = self._sent[chain, feature]
        incoming = dict(sent.incoming)
        for other in incoming:
            senders = self.model.senders[other]
            if other != feature and chain in senders:
                image = [self._sent[IMAGE, other]] if other in seen else []
                others = [self._given(name, other, seen) for name in senders if name != chain]
                incoming[other] = (*image, *others)
        return sent if incoming == sent.incoming else Sent(chain, feature, incoming)

    def _ahead(self, feature: str) -> Factors:
        """Where to search the image: messages sent by now, and predictions of the other chains."""
        predicted = [
            Sent(name, feature, {other: self._factors(other, name) for other in self.model.features_of[name]})
            for name in self.model.senders[feature]
            if (name, feature) not in self._sent
        ]
        return (*self._factors(feature), *predicted)

    def _factors(self, feature: str, without: str | None = None) -> Factors:
        """Messages sent to the feature by now, except for one chain's."""
        return self._present(
            (name, feature) for name in (IMAGE, *self.model.senders[feature]) if name != without
        )

    def _present(self, steps: Iterable[Step]) -> Factors:
        return tuple(self._sent[step] for step in steps if step in self._sent)

    def _multiply(self, feature: str, factors: Factors) -> Any:
        if len(factors) == 1:
            return self._message(factors[0])
        key = feature, factors
        if key not in self._products:
            if factors:
                product = self._multiply(feature, factors[:-1]) * self._message(factors[-1])
            else:
                product = self.model.features[feature].uniform()
            # chains that are updated side by side may ask for the same product
            return self._products.setdefault(key, product)
        return self._products[key]

    def _message(self, sent: Sent) -> Any:
        """The message, computed the first time."""
        if sent.message is None:
            node = self.model.features[sent.feature]
            if sent.sender == IMAGE:
                prior = self._multiply(sent.feature, sent.incoming[sent.feature])
                message = node.evidence(self.frame, prior)
            else:
                chain, state = self.model.chains[sent.sender], self.predictions[sent.sender]
                with naming_message(sent.sender, sent.feature):
                    message = chain.message(state, node, _Incoming(self, sent.incoming))
            if not isinstance(message, self.model.message_kinds[sent.feature]):
                raise self.model.wrong_message(sent.sender, sent.feature, message)
            sent.message = message
        return sent.message


class _WithoutImage(TimeSlice):
    """Messages of a component as they would be if the image showed nothing of it.

    What chains find in their own cavities, and what they read through cut edges, stays as it is.
    """

    def __init__(self, seen: TimeSlice, features: Sequence[str]) -> None:
        schedule = []
        for group in seen.schedule:
            steps = tuple((name, feature) for name, feature in group if name != IMAGE and feature in features)
            if steps:
                schedule.append(steps)
        super().__init__(seen.model, seen.predictions, seen.frame, schedule, seen.limits)
        self._seen = seen

    def _incoming_of(self, chain: str, feature: str) -> dict[str, Factors]:
        return {
            name: (self if chain in self.model.senders[name] else self._seen)._factors(name, chain)
            for name in self.model.features_of[chain]
        } | {feature: self._seen._sent[chain, feature].incoming[feature]}


class _Incoming(Incoming):
    """Products of factors at a chain's feature nodes, computed on demand."""

    def __init__(self, time_slice: TimeSlice, factors: Mapping[str, Factors]) -> None:
        self._slice, self._factors = time_slice, factors
        self._nodes = tuple(time_slice.model.features[name] for name in factors)
        self._results = time_slice._results

    def _message_at(self, node: Named) -> Message:
        product: Message = self._slice._multiply(node.name, self._factors[node.name])
        return product

    def _others_at(self, node: Named) -> Message:
        return self._part(node, lambda sent: sent.sender != IMAGE)

    def _evidence_at(self, node: Named) -> Message:
        return self._part(node, lambda sent: sent.sender == IMAGE)

    def _part(self, node: Named, belongs: Callable[[Sent], bool]) -> Message:
        factors = tuple(sent for sent in self._factors[node.name] if belongs(sent))
        product: Message = self._slice._multiply(node.name, factors)
        return product
