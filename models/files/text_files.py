"""Text files from anybody."""

from pathlib import Path

from .limits import MOST_TEXT


def read_text(path: Path, expected: str, most: int = MOST_TEXT) -> str:
    """Read a text file; bytes that are not UTF-8 become replacement characters, a byte order mark goes.

    Parameters
    ----------
    path
        of the file.
    expected
        what the file should hold, for messages: "expected ...".
    most
        bytes that it may hold.

    Raises
    ------
    ValueError
        naming the file, if it is longer, or binary.
    OSError
        if the file cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{path}: got more than {most} bytes, {expected}")
    if b"\0" in content:
        raise ValueError(f"{path}: got binary data, {expected}")
    return content.decode("utf-8-sig", "replace")
