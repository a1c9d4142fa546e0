"""What is wrong with a command, in one line that names the option as it was typed."""

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from cyclopts import (
    UNSET,
    Argument,
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    RepeatArgumentError,
    Token,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
    convert,
)

from .libraries import opencv_hint

TYPED = "cli"
"""Where a token is from that was typed; others are from a file, and name it."""

EXPECTED = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


def convert_strictly(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert what was typed as cyclopts does, but nothing empty, and only digits to a whole number.

    Otherwise an empty path would be the current folder, and 1.5 be rounded. What is wrong is a ValueError.
    """
    words = [word for each in _kinds(kind) if get_origin(each) is Literal for word in get_args(each)]
    for typed in (token.value for token in tokens if token.implicit_value is UNSET):
        is_taken = re.fullmatch(r"[+-]?[0-9]+", typed) or typed in words
        if not typed or (int in _kinds(kind) and not is_taken):
            raise ValueError
    return convert(kind, tokens)


def one_line(error: Exception) -> str:
    """The error's message without line breaks; system errors as "file: reason"."""
    if isinstance(error, CycloptsError):
        message = _of_arguments(error)
    elif isinstance(error, OSError) and error.strerror and error.filename is not None:
        message = f"{error.filename}: {error.strerror}"
    else:
        message = str(error)
    return " ".join(message.split()) or type(error).__name__


def reason(error: Exception) -> str:
    """What went wrong, in one line; of an error that is no refusal of an input, its kind too."""
    line = one_line(error) + opencv_hint(error)
    return line if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {line}"


def about_options(error: ValueError, *commands: Callable[..., object]) -> ValueError:
    """The error of a command, where it is about a parameter, as one about the option of that name."""
    name, _, rest = str(error).partition(":")
    if rest.startswith(" got ") and any(name in _options(command) for command in commands):
        return ValueError(f"--{name.replace('_', '-')}:{rest}")
    return error


def _options(command: Callable[..., object]) -> Iterator[str]:
    """Names of a command's parameters that are options, and of fields where one is a dataclass."""
    for parameter in inspect.signature(command).parameters.values():
        kind = next(iter(get_args(parameter.annotation)), None)
        if is_dataclass(kind):
            yield from (field.name for field in fields(kind) if field.kw_only)
        elif parameter.kind is parameter.KEYWORD_ONLY:
            yield parameter.name


def _of_arguments(error: CycloptsError) -> str:
    match error:
        case UnknownOptionError(token=token, argument_collection=arguments):
            names = [name for each in arguments if each.parse for name in each.names]
            typed = token.keyword or token.value
            return f"unknown option {typed}{meant(typed, names)}"
        case UnknownCommandError(unused_tokens=[typed, *_]) if typed.startswith("-"):
            return f"unknown option {typed}"
        case UnknownCommandError(unused_tokens=[typed, *_], app=app):
            names = [name for name in app or () if not name.startswith("-")]
            return f"unknown command {typed!r}{meant(typed, names) or f', expected {_either(names)}'}"
        case UnusedCliTokensError(unused_tokens=[typed, *_]):
            return f"got {typed!r} as well, which belongs to no option"
        case RepeatArgumentError(token=token):
            return f"{token.keyword}: got it twice, expected it once"
        case MissingArgumentError(argument=Argument() as argument):
            name = _name(argument)
            given = {each.partition("=")[0] for each in error.root_input_tokens or ()}
            expected = _expected(argument.hint)
            return f"{name}: got no value, expected {expected}" if name in given else f"{name} is needed"
        case CoercionError(argument=Argument() as argument, token=Token() as token):
            name = token.keyword or _name(argument)
            if token.source != TYPED:
                name = f"{token.source}: {name.strip('[]')}"
            elif argument.hint is bool:
                return f"{name}: got a value, expected none"
            got = repr(token.value) if token.value else "no value"
            return f"{name}: got {got}, expected {_expected(argument.hint)}"
        case _:
            return str(error)


def _name(argument: Argument) -> str:
    """As it was typed, or is in the help."""
    name = argument.name
    return name.lstrip("-").upper() if argument.field_info.is_positional else name


def _kinds(hint: Any) -> list[Any]:
    """The types of a union, or the only one; `None` and "any number of them" are never typed."""
    kinds = [hint] if get_origin(hint) is Literal else get_args(hint) or [hint]
    return [kind for kind in kinds if kind not in (NoneType, Ellipsis)]


def _expected(hint: Any) -> str:
    """For instance "a number or learned"."""
    expected: list[str] = []
    for kind in _kinds(hint):
        expected += map(str, get_args(kind)) if get_origin(kind) is Literal else [EXPECTED.get(kind, "one")]
    return _either(expected)


def _either(names: Sequence[str]) -> str:
    """For instance "a, b or c"."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def meant(typed: str, names: Iterable[str]) -> str:
    """For instance ", did you mean --out?"; nothing where no name is near."""
    near = get_close_matches(typed, list(names), 1, 0.7)
    return f", did you mean {near[0]}?" if near else ""
