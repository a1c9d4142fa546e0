"""Archives that were changed on purpose: one or several values of a real one; a state's digest fits."""

import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rsmcm.inference.engine import checkpoint

from .mutations import Files, Random

STATE = "state.npz"
PLAIN = (
    0,
    -1,
    1,
    2,
    2**31,
    2**63,
    -(2**63),
    1e308,
    -1e-320,
    float("nan"),
    float("inf"),
    "x",
    None,
    True,
    [],
    {},
)
FLOATS = (0.0, -1.0, 1.0, 0.5, 1e-320, 1e-30, -1e7, 1e15, 1e30, -1e300, np.nan, np.inf, -np.inf)
WHOLE = (0, -1, 1, 2, 3, 127, 255, 256, 32767, 65535, 2**31 - 1, -(2**31), 2**32, 2**62, 2**63 - 1, -(2**63))
TYPES = (">f8", ">i4", "f8", "f4", "i8", "i4", "u1", "i1", "u8", "?", "c16", "U3", "S5")
LARGEST = 1 << 16  # numbers of an array that grew


def forged(files: Files, archive: str, random: Random) -> Files:
    """The files of an input with another archive: arrays, or plain JSON of a state, changed once or more."""
    with np.load(io.BytesIO(files[archive])) as content:
        arrays = dict(content)
    is_state = arrays.pop(checkpoint.DIGEST, None) is not None
    skeleton = json.loads(str(arrays.pop(checkpoint.SKELETON))) if is_state else None
    for _ in range(random.geometric(0.6)):
        if skeleton and (random.random() < 0.3 or not arrays):
            _change_json(skeleton["values"], random)
        else:
            name = str(random.choice(sorted(arrays)))
            arrays[name] = _changed(arrays[name], [*arrays.values()], random)
    if is_state:
        arrays[checkpoint.SKELETON] = np.array(json.dumps(skeleton))
        arrays[checkpoint.DIGEST] = np.array(checkpoint._digest(arrays))
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    return files | {archive: stream.getvalue()}


def _one(things: Any, random: Random) -> Any:
    return things[random.integers(len(things))]


def _change_json(values: dict[str, Any], random: Random) -> None:
    """Change a leaf, or what holds it, anywhere but in the settings, which are only compared."""
    places: list[tuple[Any, Any]] = []

    def gather(holder: Any) -> None:
        for key in holder if isinstance(holder, dict) else range(len(holder)):
            if key in ("settings", "source", "parameters"):
                continue
            places.append((holder, key))
            if isinstance(holder[key], dict | list):
                gather(holder[key])

    gather(values)
    if not places:
        return
    holder, key = _one(places, random)
    kind = random.random()
    if kind < 0.1:
        del holder[key]
    elif kind < 0.2 and isinstance(holder, list):
        holder[:] = _one(([*holder, *holder], holder[::-1], holder * 100, holder[:-1]), random)
    elif kind < 0.3 and isinstance(holder, dict):
        holder[_one(("", "x", "0", "-1", "9" * 30), random)] = holder[key]
    elif kind < 0.5:
        other, where = _one(places, random)
        if other is holder or not isinstance(other[where], dict | list):
            holder[key] = other[where]
    else:
        holder[key] = _one(PLAIN, random)


def _changed(array: NDArray[Any], others: list[NDArray[Any]], random: Random) -> NDArray[Any]:
    """Another array: other numbers, another shape or type, or one from elsewhere."""
    kind = random.random()
    if kind < 0.6:
        return _other_numbers(array, random)
    if kind < 0.8:
        return _other_shape(array, random)
    if kind < 0.9:
        with np.errstate(all="ignore"):
            return array.astype(_one(TYPES, random)) if array.dtype.kind in "biuf" else array[..., None]
    return _one([each for each in others if each.dtype == array.dtype], random)


def _other_numbers(array: NDArray[Any], random: Random) -> NDArray[Any]:
    changed = array.copy().reshape(-1)
    if not len(changed) or array.dtype.kind not in "biuf":
        return changed.reshape(array.shape)
    which: Any = random.integers(len(changed), size=random.geometric(0.5))
    if random.random() < 0.2:
        which = slice(None)
    with np.errstate(all="ignore"):
        if random.random() < 0.3:  # indices that point elsewhere, of the same range
            changed[which] = random.permuted(np.resize(random.permutation(changed), changed[which].shape))
        elif array.dtype.kind == "f":
            number = _one(FLOATS, random)
            changed[which] = changed[which] * number if random.random() < 0.3 else number
        else:
            near = (len(array) if array.ndim else 1) + int(random.integers(-1, 2))
            number = int(_one((*WHOLE, near), random))
            changed[which] = np.array([number % 2**64], np.uint64).astype(array.dtype)[0]
    return changed.reshape(array.shape)


def _other_shape(array: NDArray[Any], random: Random) -> NDArray[Any]:
    if not array.ndim:
        return np.repeat(array[None], random.integers(3), axis=0)
    axis = int(random.integers(array.ndim))
    size = array.shape[axis]
    kind = random.integers(7)
    if kind == 0:
        return np.delete(array, random.integers(size), axis) if size else array[None]
    if kind == 1 and array.size < LARGEST:
        return np.concatenate([array, array], axis)
    if kind == 2 and size:
        return np.concatenate([array, np.take(array, [random.integers(size)], axis)], axis)
    if kind == 3:
        return np.take(array, [], axis)
    if kind == 4:
        return array.T
    if kind == 5:
        return array.reshape(-1)
    return array[None] if random.random() < 0.5 else np.asarray(array.reshape(-1)[0] if array.size else array)
