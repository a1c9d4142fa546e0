"""Files of morphable models: `.npz`, Candide-3, the Surrey face model, OBJ; and lists of landmarks.

An `.npz` file has the fields of `MorphableModel`: `bases (n_bases, n_vertices, 3)`, `triangles (n_triangles,
3)`, and optionally `identity` (a number), `names (n_bases,)` and `landmarks (n_landmarks,)`. In the other
formats y points up and z to the viewer; they are converted.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_files import read_arrays
from ..core.checks import checked
from ..files import MOST_NUMBERS, MOST_SETTINGS, read_text, write_atomically
from .morphable_model import MorphableModel, rms_radius

Array = NDArray[np.float64]

SURREY_SHAPE = "sfm_shape_3448.bin"
SURREY_EXPRESSIONS = "expression_blendshapes_3448.bin"
SURREY_MESH = "sfm_reference.obj"
SURREY_LANDMARKS = "ibug_to_sfm.txt"

_MOST_VERTICES = 10**6
_MOST_TRIANGLES = 2 * _MOST_VERTICES  # a closed surface has no more
_MOST_CORNERS = 1000  # of a polygon

IBUG = 68  # landmarks in the list that `SURREY_LANDMARKS` refers to


@checked
def read_model(path: str | Path) -> MorphableModel:
    """Read a morphable model; the suffix of the file is its format.

    - `.npz`: as `write_model` writes it. Bases of any scale are scaled to that of `MorphableModel`.
    - `.wfm`: Candide-3; the shape units are the identity, the animation units the expressions.
    - `.obj`: vertices and faces, one basis: a rigid object. Polygons are cut into triangles.
    - `.bin` or a folder with `sfm_shape_3448.bin`: the Surrey model. If these files are beside it,
      expressions are read from `expression_blendshapes_3448.bin`, the coarse mesh from `sfm_reference.obj`
      (with its vertices and those of landmarks only, about a quarter) and landmarks from `ibug_to_sfm.txt`.
      All 63 modes of identity are kept, each scaled by its standard deviation.

    Raises
    ------
    ValueError
        naming the file, what came and what was expected, if it is no such model.
    OSError
        if a file cannot be read.
    """
    readers: dict[str, Callable[[Path], MorphableModel]] = {
        ".npz": _read_npz,
        ".wfm": _read_candide,
        ".obj": _read_obj,
        ".bin": _read_surrey,
    }
    path = Path(path)
    file = path / SURREY_SHAPE if path.is_dir() else path
    if path.is_dir() and not file.is_file():
        raise ValueError(f"{path}: got a folder without {SURREY_SHAPE}, expected that or a model file")
    if file.suffix.lower() not in readers:
        raise ValueError(f"{path}: got {path.suffix!r}, expected a model file: {', '.join(readers)}")
    return readers[file.suffix.lower()](file)


@checked
def write_model(model: MorphableModel, path: str | Path) -> None:
    """Write a model as `.npz`, whole or not at all; `read_model` returns the same model.

    Raises
    ------
    ValueError
        if the name has another suffix.
    OSError
        if the file cannot be written; it is then as before.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise ValueError(f"{path}: got {path.suffix!r}, expected a name that ends with .npz")
    fields: dict[str, Any] = {
        "bases": model.bases,
        "triangles": model.triangles,
        "identity": model.identity,
        "names": np.array(model.names, np.str_),
    }
    if model.landmarks is not None:
        fields["landmarks"] = model.landmarks
    with write_atomically(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(file, **fields)


@checked
def read_correspondences(path: str | Path) -> NDArray[np.int64]:
    """Read which landmarks of a landmark file are which of a model.

    Parameters
    ----------
    path
        text, a pair `index = number` a line: an index (from 0) into the landmarks of the landmark file, and
        the number (from 1) of the landmark in the model's own list. What follows a `#` is a comment.

    Returns
    -------
    NDArray[np.int64]
        `(n_pairs, 2)`: indices from 0, numbers from 1 (see `MorphableModel.landmark_points`).

    Raises
    ------
    ValueError
        naming file and line, if a line is no such pair or an index comes twice, or if there is no pair.
    OSError
        if the file cannot be read.
    """
    path = Path(path)
    pairs: dict[int, int] = {}
    text = read_text(path, "expected lines like '7 = 9'", MOST_SETTINGS)
    for line_number, line in enumerate(text.splitlines(), start=1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        found = re.fullmatch(r"(\d{1,9})\s*=\s*(\d{1,9})", content)
        if found is None or int(found[2]) < 1:
            raise ValueError(
                f"{path}, line {line_number}: got {content[:60]!r}, expected a pair like '7 = 9' "
                "(index from 0 = number from 1)"
            )
        if int(found[1]) in pairs:
            raise ValueError(f"{path}, line {line_number}: got landmark {found[1]} once more")
        pairs[int(found[1])] = int(found[2])
    if not pairs:
        raise ValueError(f"{path}: got no pair of landmarks, expected lines like '7 = 9'")
    return np.array(list(pairs.items()), np.int64)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Prefix errors with the name of the file, and ignore numerical warnings of damaged numbers."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def _read_npz(path: Path) -> MorphableModel:
    expected = "expected an .npz file with bases (n_bases, n_vertices, 3) and triangles (n_triangles, 3)"
    fields = read_arrays(path, expected)
    for name in ("bases", "triangles"):
        if name not in fields or fields[name].dtype.kind not in "iuf":
            found = ", ".join(f"{key} ({fields[key].dtype})" for key in fields) or "nothing"
            raise ValueError(f"{path}: got {found}; {expected}")
    identity = fields.get("identity", np.array(0))
    if identity.size != 1 or identity.dtype.kind not in "iu":
        raise ValueError(f"{path}: identity: got {identity.dtype} {identity.shape}, expected a whole number")
    with _naming(path):
        model = MorphableModel(
            fields["bases"].astype(np.float64),
            _vertex_numbers(fields["triangles"]),
            int(identity.reshape(())),
            tuple(str(name) for name in fields.get("names", np.array([], np.str_)).reshape(-1)),
            _vertex_numbers(fields["landmarks"]) if "landmarks" in fields else None,
        )
        size = _positive_radius(model.bases)
    if abs(size - 1) < 1e-9:  # written by us: not a bit is changed
        return model
    return replace(model, bases=model.bases / size)


def _vertex_numbers(numbers: NDArray[Any]) -> NDArray[np.int64]:
    """Return whole numbers as int64; others unchanged, for the model to refuse."""
    return numbers.astype(np.int64) if numbers.dtype.kind in "iu" else numbers


def _read_obj(path: Path) -> MorphableModel:
    vertices, triangles = _obj_mesh(path)
    with _naming(path):
        return _model(vertices[None], triangles, ("shape",))


def _obj_mesh(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Return the vertices `(n, 3)` of the file, and triangles."""
    vertices, triangles = [], []
    for line_number, line in enumerate(read_text(path, "expected an .obj file").splitlines(), start=1):
        kind, *words = line.split() or [""]
        try:
            if kind == "v":
                x, y, z = (float(word) for word in words[:3])
                vertices.append((x, y, z))
            elif kind == "f":
                # counted from 1, or with minus back from the vertex before the face
                numbers = [int(word.partition("/")[0]) for word in words]
                corners = [number - 1 if number > 0 else len(vertices) + number for number in numbers]
                within = all(0 <= corner < _MOST_VERTICES for corner in corners)
                if 0 in numbers or not 3 <= len(corners) <= _MOST_CORNERS or not within:
                    raise ValueError
                triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
        except ValueError:
            raise ValueError(
                f"{path}, line {line_number}: got {line.strip()[:60]!r}, expected v and three numbers, or f "
                f"and 3 to {_MOST_CORNERS} vertices"
            ) from None
        if len(vertices) > _MOST_VERTICES or len(triangles) > _MOST_TRIANGLES:
            raise ValueError(
                f"{path}: got more than {_MOST_VERTICES} vertices or {_MOST_TRIANGLES} triangles, expected "
                "fewer"
            )
    if not vertices or not triangles:
        raise ValueError(
            f"{path}: got {len(vertices)} vertices and {len(triangles)} triangles, expected both"
        )
    return np.array(vertices), np.array(triangles, np.int64)


def _read_candide(path: Path) -> MorphableModel:
    text = read_text(path, "expected a Candide-3 .wfm file")
    words = iter([word for line in text.splitlines() for word in line.partition("#")[0].split()])

    def numbers(count: int, what: str) -> Array:
        try:
            read = np.array([float(next(words)) for _ in range(count)])
        except (ValueError, StopIteration):
            read = np.array([np.nan])
        if not np.isfinite(read).all():
            raise ValueError(f"got no complete list of {what}, expected a Candide-3 .wfm file")
        return read

    def whole(read: Array, most: int, what: str) -> NDArray[np.int64]:
        wrong = read[(read < 0) | (read > most) | (read % 1 != 0)]
        if wrong.size:
            raise ValueError(f"{what}: got {wrong[0]:g}, expected a whole number up to {most}")
        return read.astype(np.int64)

    def counted(what: str) -> int:
        return int(whole(numbers(1, what), _MOST_VERTICES, f"number of {what}")[0])

    with _naming(path):
        typical = numbers(3 * counted("vertices"), "vertices").reshape(-1, 3)
        last = len(typical) - 1
        triangles = whole(numbers(3 * counted("faces"), "faces"), last, "vertex of face").reshape(-1, 3)
        groups = []
        for what in ("animation unit", "shape unit"):
            count = counted(f"{what}s")
            if count * typical.size > MOST_NUMBERS:
                raise ValueError(f"got {count} {what}s of {len(typical)} vertices, expected fewer")
            units = [np.zeros_like(typical) for _ in range(count)]
            for unit in units:
                moved = numbers(4 * counted(f"vertices of {what}s"), what).reshape(-1, 4)
                unit[whole(moved[:, 0], last, f"vertex of {what}")] = moved[:, 1:]
            groups.append(units)
        animation, identity = groups
        names = _candide_names(text)
        named = (
            "shape",
            *_padded(names["shape"], len(identity), "shape unit"),
            *_padded(names["animation"], len(animation), "animation unit"),
        )
        return _model(np.stack([typical, *identity, *animation]), triangles, named, len(identity))


def _candide_names(text: str) -> dict[str, list[str]]:
    """Return the names of the units, which the format has in comments only."""
    names: dict[str, list[str]] = {"animation": [], "shape": []}
    group = ""
    for line in text.splitlines():
        if line.startswith("#") and ":" in line:
            found = re.match(r"#\s*(ANIMATION|SHAPE) UNITS LIST:", line)
            group = found[1].lower() if found else ""
        elif line.startswith("#") and group:
            names[group].append(line[1:].strip())
    return names


def _padded(names: list[str], count: int, otherwise: str) -> list[str]:
    if len(names) == count:
        return names
    return [f"{otherwise} {number}" for number in range(1, count + 1)]


def _read_surrey(path: Path) -> MorphableModel:
    file = _Archive(path)
    file.numbers("<i4", 1)  # version of the layout
    typical, modes, variances = file.matrix(), file.matrix(), file.matrix()
    (n_triangles,) = file.numbers("<u8", 1)
    triangles = file.numbers("<i4", 3 * int(n_triangles)).reshape(-1, 3).astype(np.int64)
    if typical.size % 3 or modes.shape != (typical.size, variances.size) or not (variances >= 0).all():
        raise ValueError(
            f"{path}: got {typical.size} coordinates, modes {modes.shape} and {variances.size} variances, "
            "expected a shape model of eos"
        )
    typical = typical.reshape(-1, 3)
    identity = (modes * np.sqrt(variances.ravel())).T.reshape(-1, *typical.shape)
    names = ["shape", *(f"identity {number}" for number in range(1, len(identity) + 1))]
    bases = [typical[None], identity]
    if path.with_name(SURREY_EXPRESSIONS).is_file():
        file = _Archive(path.with_name(SURREY_EXPRESSIONS))
        (count,) = file.numbers("<u8", 1)
        for _ in range(int(count)):
            names.append(file.word())
            shape = file.matrix()
            if shape.size != typical.size:
                named = path.with_name(SURREY_EXPRESSIONS)
                raise ValueError(f"{named}: got {shape.size} coordinates, expected {typical.size}")
            bases.append(shape.reshape(1, *typical.shape))
    landmarks = None
    if path.with_name(SURREY_LANDMARKS).is_file():
        landmarks = _surrey_landmarks(path.with_name(SURREY_LANDMARKS), len(typical))
    stacked = np.concatenate(bases)
    if path.with_name(SURREY_MESH).is_file():
        # the first vertices of the model are those of the coarse mesh, and keep their numbers
        coarse, triangles = _obj_mesh(path.with_name(SURREY_MESH))
        kept = np.arange(min(len(coarse), len(typical)))
        if landmarks is not None:
            kept = np.union1d(kept, landmarks[landmarks >= 0])
            landmarks = np.where(landmarks >= 0, np.searchsorted(kept, landmarks), -1)
        stacked = stacked[:, kept]
    with _naming(path):
        return _model(stacked, triangles, tuple(names), len(identity), landmarks)


class _Archive:
    """Numbers of a binary archive of eos (cereal, little endian), one after the other."""

    def __init__(self, path: Path) -> None:
        self._path, self._at = path, 0
        with path.open("rb") as file:
            self._content = file.read(4 * MOST_NUMBERS)  # float32; what is longer ends within its numbers

    def numbers(self, kind: str, count: int) -> NDArray[Any]:
        end = self._at + count * np.dtype(kind).itemsize
        if count < 0 or end > len(self._content):
            raise ValueError(
                f"{self._path}: got {len(self._content)} bytes that end within a list of {count} numbers, "
                "expected a model of eos"
            )
        read = np.frombuffer(self._content, kind, count, self._at)
        self._at = end
        return read

    def matrix(self) -> Array:
        """float32, column by column after its numbers of rows and columns."""
        rows, columns = (int(number) for number in self.numbers("<i4", 2))
        values = self.numbers("<f4", rows * columns if min(rows, columns) >= 0 else -1)
        with np.errstate(invalid="ignore"):  # of damage, which is found not to be finite
            return values.astype(np.float64).reshape(columns, rows).T

    def word(self) -> str:
        (length,) = self.numbers("<u8", 1)
        return bytes(self.numbers("u1", int(length))).decode("utf-8", "replace")


def _surrey_landmarks(path: Path, n_vertices: int) -> NDArray[np.int64]:
    landmarks = np.full(IBUG, -1)
    text = read_text(path, "expected lines like '7 = 9'", MOST_SETTINGS)
    for number, vertex in re.findall(r"^[ \t]*(\d{1,9})[ \t]*=[ \t]*(\d{1,9})\b", text, re.MULTILINE):
        if not 1 <= int(number) <= IBUG or int(vertex) >= n_vertices:
            raise ValueError(
                f"{path}: got {number} = {vertex}, expected landmark 1 to {IBUG} = vertex below {n_vertices}"
            )
        landmarks[int(number) - 1] = int(vertex)
    return landmarks


def _model(
    bases: Array,
    triangles: NDArray[np.int64],
    names: tuple[str, ...],
    identity: int = 0,
    landmarks: NDArray[np.int64] | None = None,
) -> MorphableModel:
    """Return a model from bases with y up and z to the viewer, of any scale and origin."""
    MorphableModel(bases, triangles, identity, names, landmarks)  # checks the numbers before they are used
    bases = bases * [1.0, -1.0, -1.0]
    bases[0] -= bases[0].mean(axis=0)
    corners = bases[0][triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2].sum()
    return MorphableModel(
        bases / _positive_radius(bases),
        triangles if facing < 0 else triangles[:, ::-1].copy(),
        identity,
        names,
        landmarks,
    )


def _positive_radius(bases: Array) -> float:
    """Return the radius of the typical shape; `ValueError` if it is tiny against the bases."""
    size = rms_radius(bases[0])
    if not 1e-9 * max(1e-30, float(np.abs(bases).max())) < size < np.inf:
        raise ValueError("got a typical shape of no size, or bases beyond all numbers")
    return size
