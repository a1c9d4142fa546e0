"""Where a live page is served."""

import re
from typing import NamedTuple

LOOPBACK = "127.0.0.1"
MOST = 65535


class Address(NamedTuple):
    """An interface of this machine, by its address or name, and a port, 0 for any that is free."""

    host: str
    port: int


def read_address(typed: str) -> Address:
    """Read `PORT`, of the loopback interface, or `HOST:PORT`; an address of IPv6 is in brackets.

    Raises
    ------
    ValueError
        if it is neither.
    """
    parts = re.fullmatch(r"(?:(\[[0-9a-fA-F:.]+\]|[\w.-]+):)?([0-9]{1,5})", typed, re.ASCII)
    if parts is None or int(parts[2]) > MOST:
        raise ValueError(f"--live: got {typed!r}, expected a port from 0 to {MOST}, or HOST:PORT")
    return Address((parts[1] or LOOPBACK).strip("[]"), int(parts[2]))
