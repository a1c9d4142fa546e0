"""Checks of what comes in: annotations declare it, `checked` holds it.

    @checked
    @dataclass(frozen=True)
    class Tracker:
        decay: Positive = 2.0  # seconds
        channels: Annotated[int, at_least(1)] = 3

    @checked
    def distances(points: Annotated[Floats, Shape("n", 2)], to: Annotated[Floats, Shape(2)]) -> float: ...

What does not hold is one line that names the parameter, what came and what was expected: a `TypeError` for
another type, a `ValueError` for another shape or range. A number is finite, unless it is a
`PositiveOrInfinite`.
"""

import math
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T", bound=Callable[..., Any])
Made = TypeVar("Made")
Sizes = dict[str, int]
Check = Callable[[Any, str, Sizes], None]
"""Raises an error if a value, which the name names, is not what is expected."""

LONGEST = 60  # characters of a value in a message


@dataclass(frozen=True)
class Bound:
    """What holds for a value, and the words for it in a message."""

    holds: Callable[[Any], bool]
    expected: str


def at_least(least: float) -> Bound:
    """Return the bound of numbers of `least` or more."""
    return Bound(lambda value: value >= least, f"{least} or more")


def between(low: float, high: float) -> Bound:
    """Return the bound of numbers from `low` to `high`."""
    return Bound(lambda value: low <= value <= high, f"{low} to {high}")


POSITIVE = Bound(lambda value: value > 0, "more than 0")
NOT_EMPTY = Bound(lambda value: len(value) > 0, "one or more")
NO_NAN = Bound(lambda numbers: not np.isnan(numbers).any(), "numbers without NaN")
PROBABILITIES = Bound(lambda numbers: bool(((numbers >= 0) & (numbers <= 1)).all()), "probabilities")
NONE_NEGATIVE = Bound(lambda numbers: bool((numbers >= 0).all()), "numbers from 0")
POSITIVES = Bound(lambda numbers: bool((numbers > 0).all()), "numbers above 0")
MOST_PIXELS = 1 << 27  # of one picture: 134 million, over four times those of 8K video, and 400 MB as colour
NEAR = Bound(lambda px: bool((np.abs(px) <= MOST_PIXELS).all()), "px that a picture may have")
"""Of places and motions of what is seen: no picture has a longer side."""
LOG_WEIGHTS = Bound(
    lambda logs: bool((logs < 1).all() and abs(np.exp(logs).sum() - 1) < 1e-3),
    "logarithms of weights with sum 1",
)
UNBOUNDED = Bound(lambda value: True, "a number")

Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, at_least(0)]
Probability = Annotated[float, Bound(lambda value: 0 < value < 1, "a probability between 0 and 1")]
Share = Annotated[float, Bound(lambda value: 0 < value < 1, "a share between 0 and 1")]
PositiveOrInfinite = Annotated[float, UNBOUNDED, POSITIVE]
NotNegativeOrInfinite = Annotated[float, UNBOUNDED, at_least(0)]
Count = Annotated[int, at_least(1)]
CountFrom0 = Annotated[int, at_least(0)]


class Shape:
    """Shape of an array: sizes, names of sizes that must agree within a call, or `None` for any size.

    Parameters
    ----------
    shape
        one entry an axis, also a product as `"height * width"`; `...` first stands for any number of leading
        axes.
    finite
        whether NaN and infinity are refused.
    """

    def __init__(self, *shape: Any, finite: bool = True) -> None:
        self.shape = shape
        self.finite = finite

    @property
    def expected(self) -> str:
        """The shape in words."""
        named = ["any" if size is None else "..." if size is ... else str(size) for size in self.shape]
        return f"shape ({', '.join(named)}{',' if len(named) == 1 else ''})"

    def check(self, value: Any, name: str, sizes: Sizes) -> None:
        """Raise a `ValueError` for another shape, or for numbers that are not finite."""
        array = np.asarray(value)
        shape, wanted = array.shape, self.shape
        if wanted and wanted[0] is ...:
            wanted = wanted[1:]
            shape = shape[max(len(shape) - len(wanted), 0) :]
        if len(shape) != len(wanted):
            raise ValueError(f"{name}: got shape {array.shape}, expected {self.expected}")
        for size, want in zip(shape, wanted, strict=True):
            if isinstance(want, str):
                names = want.split(" * ")
                product = (
                    math.prod(sizes[each] for each in names) if all(map(sizes.__contains__, names)) else size
                )
                want = sizes.setdefault(want, product)
            if want is not None and size != want:
                also = f" with {', '.join(f'{k} = {v}' for k, v in sizes.items())}" if sizes else ""
                raise ValueError(f"{name}: got shape {array.shape}, expected {self.expected}{also}")
        if self.finite and array.dtype.kind in "fc" and not np.isfinite(array).all():
            raise ValueError(f"{name}: got NaN or infinity, expected finite numbers")


class SizesOf:
    """Names of sizes that a tuple gives: `Annotated[tuple[int, int], SizesOf("height", "width")]`."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def check(self, value: Any, name: str, sizes: Sizes) -> None:
        """Raise a `ValueError` for other sizes than those of these names, or a size that is none."""
        for size, each in zip(value or (), self.names, strict=False):
            if size < 0 or sizes.setdefault(each, size) != size:
                expected = f", expected {each} = {sizes[each]}" if size >= 0 else ", expected sizes from 0"
                raise ValueError(f"{name}: got {shown(value)}{expected}")


def checked(thing: T) -> T:
    """Have the arguments of a function, or of a dataclass's constructor, checked against their annotations.

    It costs about a microsecond an argument: for what users call, not for what is called for every object.
    """
    wrapped: T = _checked_class(thing) if isinstance(thing, type) else _checked_function(thing)
    return wrapped


def made(kind: type[Made], *values: Any, **named: Any) -> Made:
    """Return a value of a `checked` dataclass, made of parts of such values, which need no check."""
    thing = object.__new__(kind)
    getattr(kind.__init__, "__wrapped__", kind.__init__)(thing, *values, **named)
    return thing


def _checked_class(kind: Any) -> Any:
    names = [str(each.name) for each in fields(kind) if each.init and not each.kw_only]
    make = kind.__init__
    checks: dict[str, Check] = {}

    @wraps(make)
    def make_checked(self: Any, *args: Any, **kwargs: Any) -> None:
        if not checks:
            hints = get_type_hints(kind, include_extras=True)
            checks.update({each.name: check_of(hints[each.name]) for each in fields(kind) if each.init})
        _check(checks, names, args, kwargs)
        make(self, *args, **kwargs)

    kind.__init__ = make_checked
    return kind


def _checked_function(function: Any) -> Any:
    parameters = signature(function).parameters.values()
    positional = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
    names = [each.name for each in parameters if each.kind in positional]
    checks: dict[str, Check] = {}

    @wraps(function)
    def with_checks(*args: Any, **kwargs: Any) -> Any:
        if not checks:
            own = {name: hint for name, hint in function.__annotations__.items() if name != "return"}
            annotated = types.SimpleNamespace(__annotations__=own)  # without what is returned
            hints = get_type_hints(annotated, function.__globals__, include_extras=True)
            variable = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
            named = [each.name for each in parameters if each.kind not in variable]
            checks.update({name: check_of(hints.get(name, Any)) for name in named})
        _check(checks, names, args, kwargs)
        return function(*args, **kwargs)

    return with_checks


def _check(checks: dict[str, Check], names: list[str], args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
    sizes: Sizes = {}
    for name, value in zip(names, args, strict=False):
        checks[name](value, name, sizes)
    for name, value in kwargs.items():
        if name in checks:
            checks[name](value, name, sizes)


@cache
def check_of(hint: Any) -> Check:
    """Return the check that an annotation declares; what cannot be checked at run time is taken as it is."""
    origin, arguments = get_origin(hint), get_args(hint)
    alias = getattr(origin or hint, "__value__", None)  # of the statement `type`, as numpy has from 2.5 on
    if alias is not None:
        return check_of(alias if not arguments else alias[arguments]) if len(arguments) < 2 else _anything
    if isinstance(hint, TypeVar) or hint in (Any, object):
        return _anything
    if origin is Annotated:
        return _check_of_annotated(arguments[0], arguments[1:])
    if origin in (Union, types.UnionType):
        return _check_of_union(arguments)
    if origin is Literal:
        return _by(lambda value: value in arguments, " or ".join(map(repr, arguments)), ValueError)
    if hint is None or hint is types.NoneType:
        return _by(lambda value: value is None, "None")
    if hint is float:
        return _number(finite=True)
    if hint in NAMED:
        return _by(*NAMED[hint])
    if origin is np.ndarray or hint is np.ndarray:
        return _check_of_array(arguments)
    if origin is tuple:
        return _check_of_tuple(arguments)
    if origin in (list, Sequence, set, frozenset, dict, Mapping):
        return _check_of_items(origin, arguments)
    if origin is not None and not isinstance(origin, type):
        return _anything
    kind = origin or hint
    if kind is Callable:
        return _by(callable, "a function")
    if not isinstance(kind, type) or (getattr(kind, "_is_protocol", False) and not _at_run_time(kind)):
        return _anything
    return _by(lambda value: isinstance(value, kind), _words_of(kind))


NAMED: dict[Any, tuple[Callable[[Any], bool], str]] = {
    bool: (lambda value: isinstance(value, bool | np.bool_), "True or False"),
    int: (lambda value: isinstance(value, Integral) and not isinstance(value, bool), "a whole number"),
    str: (lambda value: isinstance(value, str), "a text"),
}


def _words_of(kind: type) -> str:
    if kind is Iterable:
        return "an iterable"
    return f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"


def _at_run_time(protocol: type) -> bool:
    return bool(getattr(protocol, "_is_runtime_protocol", False))


def _anything(value: Any, name: str, sizes: Sizes) -> None:
    """Take any value."""


def _by(holds: Callable[[Any], bool], expected: str, error: type[Exception] = TypeError) -> Check:
    def check(value: Any, name: str, sizes: Sizes) -> None:
        try:
            is_right = holds(value)
        except (TypeError, ValueError):
            is_right = False
        if not is_right:
            raise error(f"{name}: got {shown(value)}, expected {expected}")

    check.expected = expected  # type: ignore[attr-defined]
    return check


def _number(finite: bool) -> Check:
    def check(value: Any, name: str, sizes: Sizes) -> None:
        is_number = isinstance(value, Real | np.bool_) and not isinstance(value, bool | np.bool_)
        if not is_number:
            raise TypeError(f"{name}: got {shown(value)}, expected a number")
        try:
            is_right = not (math.isnan(value) or (finite and math.isinf(value)))
        except OverflowError:  # a whole number with hundreds of digits
            is_right = False
        if not is_right:
            raise ValueError(f"{name}: got {shown(value)}, expected a {'finite ' if finite else ''}number")

    check.expected = "a number"  # type: ignore[attr-defined]
    return check


def _check_of_annotated(hint: Any, marks: tuple[Any, ...]) -> Check:
    checks = [_number(finite=False) if hint is float and UNBOUNDED in marks else check_of(hint)]
    for mark in marks:
        if isinstance(mark, Bound):
            checks.append(_by(mark.holds, mark.expected, ValueError))
        elif isinstance(mark, Shape | SizesOf):
            checks.append(mark.check)

    def check(value: Any, name: str, sizes: Sizes) -> None:
        for each in checks:
            each(value, name, sizes)

    words = [getattr(each, "expected", "") for each in checks]
    check.expected = next((each for each in reversed(words) if each), "")  # type: ignore[attr-defined]
    return check


def _check_of_union(hints: tuple[Any, ...]) -> Check:
    checks = [check_of(hint) for hint in hints]
    expected = " or ".join(
        getattr(each, "expected", "") or str(hint) for each, hint in zip(checks, hints, strict=True)
    )

    def check(value: Any, name: str, sizes: Sizes) -> None:
        out_of_range = None
        for each in checks:
            try:
                return each(value, name, sizes)
            except ValueError as error:  # of the right type: this is the one that was meant
                out_of_range = out_of_range or error
            except TypeError:
                continue
        if out_of_range is not None:
            raise out_of_range
        raise TypeError(f"{name}: got {shown(value)}, expected {expected}")

    check.expected = expected  # type: ignore[attr-defined]
    return check


def _check_of_array(arguments: tuple[Any, ...]) -> Check:
    """Of `NDArray[type]`: bytes, truth values and records exactly, floating numbers of any real type."""
    kinds = get_args(arguments[1]) if len(arguments) > 1 else ()
    kind = kinds[0] if kinds and isinstance(kinds[0], type) and kinds[0] not in (Any, np.generic) else None
    allowed = None
    if kind is not None and issubclass(kind, np.floating):
        allowed = "fiu"
    elif kind is not None and issubclass(kind, np.integer) and kind is not np.uint8:
        allowed = "iu"
    expected = f"an array of {kind.__name__}" if kind is not None else "an array"

    def holds(value: Any) -> bool:
        if not isinstance(value, np.ndarray) or kind is None:
            return isinstance(value, np.ndarray)
        return value.dtype.kind in allowed if allowed else issubclass(value.dtype.type, kind)

    return _by(holds, expected)


def _check_of_tuple(arguments: tuple[Any, ...]) -> Check:
    if len(arguments) == 2 and arguments[1] is ...:
        return _check_of_items(tuple, arguments[:1])
    checks = [check_of(each) for each in arguments]

    def check(value: Any, name: str, sizes: Sizes) -> None:
        if not isinstance(value, tuple | list) or len(value) != len(checks):
            raise TypeError(f"{name}: got {shown(value)}, expected {len(checks)} values")
        for index, (each, item) in enumerate(zip(checks, value, strict=True)):
            each(item, f"{name}[{index}]", sizes)

    check.expected = f"{len(checks)} values"  # type: ignore[attr-defined]
    return check


def _check_of_items(kind: Any, arguments: tuple[Any, ...]) -> Check:
    of_items = check_of(arguments[-1]) if arguments else _anything
    words = {Sequence: "a sequence", Mapping: "a mapping"}.get(kind, f"a {getattr(kind, '__name__', kind)}")

    def check(value: Any, name: str, sizes: Sizes) -> None:
        if not isinstance(value, (tuple, list) if kind is tuple else kind) or isinstance(value, str):
            raise TypeError(f"{name}: got {shown(value)}, expected {words}")
        if of_items is not _anything:
            pairs = value.items() if isinstance(value, Mapping) else enumerate(value)
            for key, item in pairs:
                of_items(item, f"{name}[{key!r}]", sizes)

    check.expected = words  # type: ignore[attr-defined]
    return check


def shown(value: Any) -> str:
    """Return a value in the few words of a message."""
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} of shape {value.shape}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    words = " ".join(repr(value).split())
    if words.startswith("<"):
        return f"a {type(value).__name__}"
    return words if len(words) <= LONGEST else f"{words[:LONGEST]}..."
