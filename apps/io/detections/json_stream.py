"""JSON that is read value by value: a file of a million detections is never in memory as a whole."""

import json
from collections.abc import Iterator
from json.decoder import JSONDecoder
from pathlib import Path
from typing import Any, TextIO

from ....models.files import MOST_TEXT

PIECE = 1 << 20
"""Characters that are read at once."""

BLANK = " \t\r\n"


class JsonStream:
    """A JSON text, of which lists and objects are entered and their values taken one by one.

    Parameters
    ----------
    path
        for messages.
    file
        open for reading.
    expected
        what it should hold, for messages.
    """

    def __init__(self, path: Path, file: TextIO, expected: str) -> None:
        self._path = path
        self._expected = expected
        self._file = file
        self._decoder = JSONDecoder()
        self._text = ""
        self._place = 0
        self._line = 1  # in which the text begins

    def peek(self) -> str:
        """The next character that is not blank; nothing at the end."""
        while True:
            for place in range(self._place, len(self._text)):
                if self._text[place] not in BLANK:
                    self._place = place
                    return self._text[place]
            self._place = len(self._text)
            if not self._more():
                return ""

    def items(self) -> Iterator[Any]:
        """The values of the list that begins here.

        Raises
        ------
        ValueError
            naming file and line, if it is no list, or broken.
        """
        self._take("[")
        while self.peek() != "]":
            yield self.value()
            self._separate("]")
        self._take("]")

    def entries(self) -> Iterator[str]:
        """The keys of the object that begins here; after each, its value is to be taken.

        Raises
        ------
        ValueError
            naming file and line, if it is no object, or broken.
        """
        self._take("{")
        while self.peek() != "}":
            key = self.value()
            if not isinstance(key, str):
                raise self._wrong("no JSON")
            self._take(":")
            yield key
            self._separate("}")
        self._take("}")

    def value(self) -> Any:
        """The value that begins here, whole.

        Raises
        ------
        ValueError
            naming file and line, if it is broken, or too long.
        """
        self.peek()
        while True:
            try:
                value, end = self._decoder.raw_decode(self._text, self._place)
            except json.JSONDecodeError:
                if not self._more():
                    raise self._wrong("no JSON, or a part of it") from None
                continue
            except (ValueError, RecursionError):  # a number of thousands of digits, lists without end
                raise self._wrong("no value that such a file has") from None
            if end < len(self._text) or not self._more():
                self._place = end
                return value

    def end(self) -> None:
        """Make sure that nothing follows.

        Raises
        ------
        ValueError
            naming file and line, if something does.
        """
        if self.peek():
            raise self._wrong("more behind the end")

    def _separate(self, end: str) -> None:
        """Take a comma, unless the end comes."""
        if self.peek() != end:
            self._take(",")

    def _take(self, character: str) -> None:
        if self.peek() != character:
            raise self._wrong("no JSON" if self._text[self._place :] else "a part of a file")
        self._place += 1

    def _more(self) -> bool:
        """Read on, twice as much as is held: what cannot be read yet is not tried too often."""
        piece = self._file.read(max(PIECE, len(self._text) - self._place))
        if "\0" in piece:
            raise self._wrong("binary data")
        self._line += self._text.count("\n", 0, self._place)
        self._text = self._text[self._place :] + piece
        self._place = 0
        if len(self._text) > MOST_TEXT:
            raise self._wrong(f"a value of more than {MOST_TEXT >> 1} characters")
        return bool(piece)

    def _wrong(self, got: str) -> ValueError:
        line = self._line + self._text.count("\n", 0, self._place)
        return ValueError(f"{self._path}, line {line}: got {got}, expected {self._expected}")
