"""Files of arrays from anybody: what is read, and how damage is told."""

import io
import json
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from rsmcm.models.array_files import SINGLE, Arrays, read_arrays
from rsmcm.models.files import MOST_NUMBERS

EXPECTED = "expected numbers"

some_arrays = arrays_of.arrays(
    st.one_of(
        arrays_of.floating_dtypes(endianness="?"),
        arrays_of.integer_dtypes(endianness="?"),
        arrays_of.boolean_dtypes(),
        arrays_of.unicode_string_dtypes(endianness="?"),
    ),
    arrays_of.array_shapes(min_dims=0, min_side=0, max_side=4),
)


def npy(array: Any, **options: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


def npy_of_header(header: str, data: bytes = b"") -> bytes:
    """An `.npy` file with any text in the place of its header."""
    text = header.encode("latin-1")
    return np.lib.format.magic(1, 0) + struct.pack("<H", len(text)) + text + data


def header(shape: object, descr: object = "<f8") -> str:
    return f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape!r}, }}\n"


def zipped(members: dict[str, bytes], how: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An archive with correct check sums, whatever its members hold."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", how) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def assert_same(found: Arrays, wanted: Arrays) -> None:
    assert found.keys() == wanted.keys()
    for name, array in wanted.items():
        assert found[name].dtype == array.dtype
        assert found[name].shape == array.shape
        assert found[name].tobytes() == array.tobytes()


@given(st.dictionaries(st.text("abc/ é", min_size=1), some_arrays, max_size=3), st.booleans())
def test_what_numpy_writes_is_read(
    tmp_path_factory: pytest.TempPathFactory, arrays: Arrays, packed: bool
) -> None:
    folder = tmp_path_factory.mktemp("arrays")
    with (folder / "some.npz").open("wb") as file:
        (np.savez_compressed if packed else np.savez)(file, **arrays)
    assert_same(read_arrays(folder / "some.npz", EXPECTED), arrays)
    for array in arrays.values():
        (folder / "one").write_bytes(npy(array))
        assert_same(read_arrays(folder / "one", EXPECTED), {SINGLE: array})


def refusal(path: Path, content: bytes) -> str:
    """What is said of it, in one line, without taking memory for it."""
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=rf"^{path}: got [^\n]*, {EXPECTED}$") as raised:
            read_arrays(path, EXPECTED)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 3 * len(content) + (1 << 22)
    return str(raised.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "neither .npy nor .npz"),
        (b"\x89PNG", "neither .npy nor .npz"),
        (npy(np.eye(3))[:-9], "array (3, 3) float64 with 63 bytes instead of 72"),
        (npy(np.eye(3)) + b"0", "with 73 bytes instead of 72"),
        (npy_of_header(header((10**9,))), "array (1000000000,) float64, more numbers than are taken"),
        (npy_of_header(header((10**30, 0))), "damaged"),
        (npy_of_header(header((-1,))), "of shape (-1,)"),
        (npy_of_header(header((1 << 32, 1 << 32))), "more numbers"),
        (npy_of_header(header((2,), "<U99999999")), "more numbers"),
        (npy_of_header(header((True,))), "array"),
        (npy_of_header(header((2,), "|O"), b"\x80\x04N."), "array of objects"),
        (npy_of_header(header((2,), [("a", "|O")])), "array of objects"),
        (npy_of_header(header((2,), [("a", "<f4")])), "array of [('a', '<f4')]"),
        (npy_of_header(header((2,), "<M8[s]"), bytes(16)), "array of datetime64[s]"),
        (npy_of_header(header((2,), "nonsense")), "damaged"),
        (npy_of_header("{'descr': '<f8', 'fortran_order': False, 'shape': (3L,"), "damaged"),
        (npy_of_header("(" * 9000), "damaged"),
        (npy_of_header("-" * 9000 + "1"), "damaged"),
        (npy_of_header("\n" * 60_000), "damaged"),
        (npy(np.eye(3))[:4] + b"XX" + npy(np.eye(3))[6:], "damaged"),
        (b"PK\x03\x04 and no more", "damaged"),
        (zipped({"a.npy": b"no array"}), "damaged"),
        (zipped({"a.npy": npy(np.zeros(3)), "a": npy(np.zeros(3))}), "array 'a' twice"),
        (zipped({"a.npy": npy(np.array([{}]), allow_pickle=True)}), "array 'a' of objects"),
        (zipped({"a.npy": npy(np.zeros(3))}, zipfile.ZIP_LZMA), "packed in a way that is not numpy's"),
        (zipped({"a.npy": npy(np.zeros(3))}, zipfile.ZIP_BZIP2), "packed in a way that is not numpy's"),
        (zipped({"a.npy": npy(np.zeros(3))[:-1]}), "array 'a' (3,) float64 with 23 bytes instead of 24"),
    ],
)
def test_what_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    assert words in refusal(tmp_path / "a.npz", content)


def test_zip_bombs(tmp_path: Path) -> None:
    """A small file that unpacks to more than is taken is refused from its headers."""
    n_bytes = 8 * MOST_NUMBERS // 2 + 8
    half = npy_of_header(header((n_bytes // 8,)), bytes(n_bytes))
    bomb = zipped({"a.npy": half})
    assert len(bomb) < n_bytes / 900
    (tmp_path / "a.npz").write_bytes(bomb)
    assert read_arrays(tmp_path / "a.npz", EXPECTED).keys() == {"a"}
    with pytest.raises(ValueError, match=r"array 'a' of .* bytes, more than are taken"):
        read_arrays(tmp_path / "a.npz", EXPECTED, most=MOST_NUMBERS // 4)
    (tmp_path / "b.npz").write_bytes(zipped({"a.npy": half, "b.npy": half}))
    with pytest.raises(ValueError, match=r"array 'b' \(16777217,\) float64, more numbers than"):
        read_arrays(tmp_path / "b.npz", EXPECTED)


@settings(max_examples=20)
@given(st.integers(0, 2**32))
def test_every_flipped_bit_is_seen_or_harmless(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    random = np.random.default_rng(seed)
    arrays: Arrays = {"a": random.normal(size=(3, 4)), "about": np.array(json.dumps({"b": [1, 2]}))}
    path = tmp_path_factory.mktemp("flipped") / "a.npz"
    np.savez_compressed(path, **arrays)
    whole = path.read_bytes()
    for position in random.integers(len(whole), size=30):
        content = bytearray(whole)
        content[position] ^= 1 << random.integers(8)
        path.write_bytes(content)
        message = f"{path}: got "
        try:
            found = read_arrays(path, EXPECTED)
        except ValueError as error:
            message = str(error)
        else:  # a date or a flag of the zip's own
            assert_same(found, arrays)
        assert message.startswith(f"{path}: got ")
        assert "\n" not in message
