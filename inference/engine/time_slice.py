"""Messages of one frame: when each is sent, when it is worked out, and what all of them say of the image."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

from ...models.core.frame import Frame
from .graph import IMAGE, MultiChain, Step
from .protocols import Cavity, Incoming, Message, Named, Scratch


@dataclass(eq=False)
class Sent:
    """A message of a time slice, which is worked out when it is first multiplied.

    Parameters
    ----------
    sender, feature
        names; the image is a sender too.
    incoming
        by feature, the factors of what the sender goes by.
    message
        the message itself, once it is worked out.
    """

    sender: str
    feature: str
    incoming: Mapping[str, "Factors"]
    message: Any = None


Factors = tuple[Sent, ...]


class TimeSlice:
    """Messages of one frame, and their products.

    The same factors always give the same product object, so that messages may keep what they work out. No
    message refers to the slice: it is gone as soon as nobody needs it, and large arrays with it.
    """

    def __init__(self, model: MultiChain, predictions: Mapping[str, Any], frame: Frame) -> None:
        self.model = model
        self.predictions = predictions
        self.frame = frame
        self._scratch = Scratch()
        self._sent: dict[Step, Sent] = {}
        self._products: dict[tuple[str, Factors], Any] = {}

    def send(self, sender: str, feature: str) -> None:
        """Send a message that follows from what has been sent by now, unless it is the one sent before."""
        if sender == IMAGE:
            if self.frame.missing or (IMAGE, feature) in self._sent:
                return
            incoming = {feature: self._ahead(feature) if self.model.features[feature].searches else ()}
        else:
            incoming = {name: self._factors(name, sender) for name in self.model.features_of(sender)}
            incoming[feature] = self._cavity(sender, feature)
        before = self._sent.get((sender, feature))
        if before is None or before.incoming != incoming:
            self._sent[sender, feature] = Sent(sender, feature, incoming)

    def incoming(self, chain: str) -> Incoming:
        """All that reaches the chain by now except for its own messages."""
        return self._incoming({name: self._factors(name, chain) for name in self.model.features_of(chain)})

    def sent(self, sender: str, feature: str) -> Any:
        """The message of a chain, or of the image, to the feature.

        Raises
        ------
        KeyError
            if there is none.
        """
        if (sender, feature) not in self._sent:
            raise KeyError(f"{sender!r} says nothing to {feature!r}")
        return self._message(self._sent[sender, feature])

    def product(self, feature: str) -> Any:
        """Product of all that the feature has been sent by now."""
        return self._multiply(feature, self._factors(feature))

    def log_evidence(self) -> float:
        """Log p(image | past), by the chain rule: that of each feature given those before it."""
        return float(
            sum(
                self._log_evidence_at(feature, features[:number])
                for features in self.model.components()
                for number, feature in enumerate(features)
            )
        )

    def _log_evidence_at(self, feature: str, seen: Sequence[str]) -> float:
        """Log probability of what the image shows of a feature, given what it shows of those `seen`.

        The messages to the feature are the same in both integrals, so that their scale does not matter.
        """
        if (IMAGE, feature) not in self._sent:
            return 0.0
        predicted = tuple(self._given(name, feature, seen) for name in self.model.senders(feature))
        log_mass = self._multiply(feature, (self._sent[IMAGE, feature], *predicted)).log_mass
        return float(log_mass - self._multiply(feature, predicted).log_mass) if log_mass > -inf else -inf

    def _given(self, chain: str, feature: str, seen: Sequence[str]) -> Sent:
        """What the chain would send if the image showed no feature of its component but those `seen`.

        What it found in its own cavity, where it may have decided where to speak, and what it reads through
        cut edges stays as it is.
        """
        sent = self._sent[chain, feature]
        incoming = dict(sent.incoming)
        for other in incoming:
            senders = self.model.senders(other)
            if other != feature and chain in senders:
                image = [self._sent[IMAGE, other]] if other in seen else []
                others = [self._given(name, other, seen) for name in senders if name != chain]
                incoming[other] = (*image, *others)
        return sent if incoming == sent.incoming else Sent(chain, feature, incoming)

    def _ahead(self, feature: str) -> Factors:
        """Where the image is to be searched: what was said by now, and what the others say of it unseen.

        Those who want to hear the image before they speak predict here without it. They speak again when it
        has been searched, and nobody but the search hears what they said first.
        """
        predicted = [
            Sent(name, feature, {other: self._factors(other, name) for other in self.model.features_of(name)})
            for name in self.model.senders(feature)
            if (name, feature) not in self._sent
        ]
        return (*self._factors(feature), *predicted)

    def _cavity(self, chain: str, feature: str) -> Factors:
        """What the chain finds of others at a feature to which it is about to speak."""
        wanted = self.model.cavity(chain, feature)
        if wanted == Cavity.OTHERS:
            return self._factors(feature, chain)
        image = self._sent.get((IMAGE, feature))
        return () if image is None or wanted == Cavity.NOTHING else (image,)

    def _factors(self, feature: str, without: str | None = None) -> Factors:
        """What the feature has been sent by now, but for one chain's message."""
        steps = [(name, feature) for name in (IMAGE, *self.model.senders(feature)) if name != without]
        return tuple(self._sent[step] for step in steps if step in self._sent)

    def _incoming(self, factors: Mapping[str, Factors]) -> Incoming:
        return Incoming(_Products(self, factors), self._scratch)

    def _multiply(self, feature: str, factors: Factors) -> Any:
        if len(factors) == 1:
            return self._message(factors[0])
        key = feature, factors
        if key not in self._products:
            if factors:
                product = self._multiply(feature, factors[:-1]) * self._message(factors[-1])
            else:
                product = self.model.features[feature].uniform()
            self._products[key] = product
        return self._products[key]

    def _message(self, sent: Sent) -> Any:
        """The message that was sent.

        Raises
        ------
        TypeError
            if it is none of its feature.
        """
        if sent.message is None:
            node = self.model.features[sent.feature]
            if sent.sender == IMAGE:
                prior = self._multiply(sent.feature, sent.incoming[sent.feature])
                message = node.evidence(self.frame, prior)
            else:
                chain, state = self.model.chains[sent.sender], self.predictions[sent.sender]
                message = chain.message(state, node, self._incoming(sent.incoming))
            self.model.require_message(sent.sender, sent.feature, message)
            sent.message = message
        return sent.message


class _Products(Mapping[Named, Message]):
    """Product of some factors at each of a chain's feature nodes, worked out when it is asked for."""

    def __init__(self, time_slice: TimeSlice, factors: Mapping[str, Factors]) -> None:
        self._slice = time_slice
        self._factors = factors

    def __getitem__(self, feature: Named) -> Message:
        product: Message = self._slice._multiply(feature.name, self._factors[feature.name])
        return product

    def __iter__(self) -> Iterator[Named]:
        return (self._slice.model.features[name] for name in self._factors)

    def __len__(self) -> int:
        return len(self._factors)
