"""Damage of all kinds: flipped bits, cuts, splices, edited headers and numbers, archives packed anew."""

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

Random = np.random.Generator
Files = dict[str, bytes]

NUMBERS = (
    b"0", b"-1", b"1", b"2", b"255", b"256", b"65535", b"1e9", b"1000000000", b"2147483648", b"-2147483649",
    b"9223372036854775807", b"9223372036854775808", b"18446744073709551616", b"1e308", b"1e309", b"-1e300",
    b"1e-320", b"nan", b"inf", b"-inf", b"0.5", b"1e7", b"9" * 400, b"9" * 5000, b"0x10", b"1_000", b"True",
)  # fmt: skip
WORDS = (b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\n" * 40, b"#", b"=", b"[" * 3000, b"{a=" * 2000, b",", b'"')
WHOLE = (0, 1, 2, 3, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
FLOATS = (0.0, -0.0, np.nan, np.inf, -np.inf, 1e-320, 1e-30, 1e7, 1e30, 1e308, -1e308)
SHAPES = (
    (), (0,), (1,), (-1,), (2, 2), (10**9,), (10**30, 0), (2**32, 2**32), (1, 1, 2), (3, 4, 2), (1,) * 40,
)  # fmt: skip
TYPES = (
    "<f8", ">f8", "<f4", "<f2", "<i8", "|i1", "<u8", "|b1", "<c16", "|O", "<U3", "|S5", "<M8[s]",
)  # fmt: skip
KEPT = {"run.json", "out/state.npz"}
"""Names of files that are not damaged: they say what is run, and states are forged by themselves."""
LONGEST = 1 << 22  # bytes of an input that grew


def mutated(files: Files, others: list[Files], random: Random) -> Files:
    """One of the files of an input, or several, damaged once or a few times."""
    files = dict(files)
    for _ in range(random.geometric(0.7)):
        name = str(random.choice(sorted(files.keys() - KEPT)))
        if random.random() < 0.02:
            files[name] = b""
        elif random.random() < 0.02:
            files[name] = files[str(random.choice(sorted(files.keys() - KEPT)))]
        elif random.random() < 0.01 and len(files.keys() - KEPT) > 1:
            del files[name]
        else:
            other = others[random.integers(len(others))]
            files[name] = _damaged(files[name], other[str(random.choice(sorted(other)))], random)[:LONGEST]
    return files


def _damaged(content: bytes, other: bytes, random: Random) -> bytes:
    """Damaged where its own format hurts, or anywhere."""
    if content and random.random() < 0.6:
        if content.startswith(b"PK\x03\x04"):
            return _packed_anew(content, other, random)
        if content.startswith(b"\x93NUMPY"):
            return _other_array(content, random)
        if content.startswith(b"\x89PNG"):
            return _other_chunk(content, random)
        if b"\0" not in content[:1000]:
            return _other_text(content, random)
    return _pick(BYTES, random)(content, other, random)


def _pick(kinds: tuple[Callable[..., bytes], ...], random: Random) -> Callable[..., bytes]:
    return kinds[random.integers(len(kinds))]


def _place(content: bytes, random: Random) -> int:
    """Anywhere; half of the time near the beginning, where headers are."""
    if random.random() < 0.5:
        return int(random.integers(len(content) + 1))
    return int((len(content) + 1) ** random.random()) - 1


# --- any bytes ----------------------------------------------------------------------------------------------


def _flipped(content: bytes, _: bytes, random: Random) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(random.geometric(0.5)):
        changed[min(_place(content, random), len(changed) - 1)] ^= 1 << random.integers(8)
    return bytes(changed)


def _overwritten(content: bytes, _: bytes, random: Random) -> bytes:
    kind = str(random.choice(["<u2", ">u2", "<u4", ">u4", "u1"]))
    number = np.array(WHOLE[random.integers(len(WHOLE))] % 2 ** (8 * np.dtype(kind).itemsize), kind).tobytes()
    place = _place(content, random)
    return content[:place] + number + content[place + len(number) :]


def _cut(content: bytes, _: bytes, random: Random) -> bytes:
    return content[: _place(content, random)]


def _spliced(content: bytes, other: bytes, random: Random) -> bytes:
    return content[: _place(content, random)] + other[_place(other, random) :]


BYTES = (_flipped, _flipped, _overwritten, _overwritten, _cut, _spliced)


# --- text ---------------------------------------------------------------------------------------------------


def _other_text(content: bytes, random: Random) -> bytes:
    return _pick(TEXTS, random)(content, random)


def _other_number(content: bytes, random: Random) -> bytes:
    found = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", content))
    if not found:
        return content + NUMBERS[random.integers(len(NUMBERS))]
    chosen = found[random.integers(len(found))]
    return content[: chosen.start()] + NUMBERS[random.integers(len(NUMBERS))] + content[chosen.end() :]


def _other_word(content: bytes, random: Random) -> bytes:
    place = _place(content, random)
    return content[:place] + WORDS[random.integers(len(WORDS))] + content[place:]


def _other_lines(content: bytes, random: Random) -> bytes:
    lines = content.splitlines(keepends=True)
    one, two = random.integers(len(lines), size=2)
    lines[one] = (b"", lines[two], lines[two] * 100, lines[one].rstrip(b"\n") + lines[two])[
        random.integers(4)
    ]
    return b"".join(lines)


TEXTS = (_other_number, _other_number, _other_word, _other_lines)


# --- arrays and archives ------------------------------------------------------------------------------------


def _other_array(content: bytes, random: Random) -> bytes:
    """Another header, of the right length, or other values."""
    (length,) = struct.unpack("<H", content[8:10].ljust(2, b"\0"))
    header, data = content[10 : 10 + length], content[10 + length :]
    kind = random.integers(5)
    if kind == 0:
        header = _other_text(header, random) if header else header
    elif kind == 1:
        shape = repr(SHAPES[random.integers(len(SHAPES))]).encode()
        header = re.sub(rb"\([\d, ]*\)", lambda _: shape, header, count=1)
    elif kind == 2:
        header = re.sub(rb"'[<>|=]\w+'", repr(str(random.choice(TYPES))).encode(), header, count=1)
    elif kind == 3 and len(data) >= 8:
        place = 8 * int(random.integers(len(data) // 8))
        value = struct.pack("<d", FLOATS[random.integers(len(FLOATS))])
        data = data[:place] + value + data[place + 8 :]
    else:
        data = _pick(BYTES, random)(data, header, random)
    return content[:8] + struct.pack("<H", len(header) % 65536) + header + data


def _packed_anew(content: bytes, other: bytes, random: Random) -> bytes:
    """An archive whose members were changed, with correct check sums."""
    try:
        members, others = _members(content), _members(other) if other.startswith(b"PK") else {}
    except Exception:  # damaged before
        return _flipped(content, other, random)
    if not members:
        return _flipped(content, other, random)
    name = str(random.choice(sorted(members)))
    kind = random.integers(6)
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[str(random.choice(["a.npy", "tracks", "../up.npy", "x" * 300, *members]))] = members.pop(name)
    elif kind == 2 and others:
        members[name] = others[str(random.choice(sorted(others)))]
    else:
        members[name] = _damaged(members[name], other, random)
    how = zipfile.ZIP_STORED
    if random.random() < 0.3:
        how = int(random.choice([zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", how) as archive:
        for member, data in members.items():
            archive.writestr(zipfile.ZipInfo(member), data, how)  # without a date: the same bytes again
    return stream.getvalue()


def _members(content: bytes) -> Files:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {member.filename: archive.read(member) for member in archive.infolist()}


def _other_chunk(content: bytes, random: Random) -> bytes:
    """A PNG one of whose chunks was changed, with a correct check sum."""
    place, chunks = 8, []
    while place + 12 <= len(content):
        (length,) = struct.unpack(">I", content[place : place + 4])
        chunks.append((content[place + 4 : place + 8], content[place + 8 : place + 8 + length]))
        place += 12 + length
    if not chunks:
        return _flipped(content, b"", random)
    chosen = int(random.integers(len(chunks))) if random.random() < 0.5 else 0
    kind, data = chunks[chosen]
    chunks[chosen] = kind, _pick(BYTES, random)(data, content, random)
    return content[:8] + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
