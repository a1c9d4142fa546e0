"""Tiny networks as ONNX files: with the inputs and outputs of OpenCV's YuNet, and of a YOLO."""

import struct

import numpy as np
from numpy.typing import NDArray

STRIDES, OUTPUTS = (8, 16, 32), {"cls": 1, "obj": 1, "bbox": 4, "kps": 10}
FLOAT, INT64 = 1, 7  # ONNX's types of elements
WHOLE, LIST = 2, 7  # and of attributes


def tiny_network() -> bytes:
    """An average over each cell, and as many random sums of its three colours as an output has columns."""
    nodes, weights, results = b"", b"", b""
    for stride in STRIDES:
        cell = _list("kernel_shape", stride, stride) + _list("strides", stride, stride)
        nodes += _node("AveragePool", ["input"], f"cells{stride}", cell)
        for name, columns in OUTPUTS.items():
            out = f"{name}_{stride}"
            values = struct.pack(f"<{3 * columns}f", *(0.001 * (k % 7) for k in range(3 * columns)))
            weights += _field(5, _tensor(f"w{out}", [columns, 3, 1, 1], FLOAT, values))
            weights += _field(5, _tensor(f"s{out}", [3], INT64, struct.pack("<3q", 1, -1, columns)))
            nodes += _node("Conv", [f"cells{stride}", f"w{out}"], f"c{out}", _list("kernel_shape", 1, 1))
            nodes += _node("Transpose", [f"c{out}"], f"t{out}", _list("perm", 0, 2, 3, 1))
            nodes += _node("Reshape", [f"t{out}", f"s{out}"], out, b"")
            results += _field(12, _value(out, [1, (640 // stride) ** 2, columns]))
    graph = nodes + _field(2, b"g") + weights + _field(11, _value("input", [1, 3, 640, 640])) + results
    return _number(1, 6) + _field(7, graph) + _field(8, _field(1, b"") + _number(2, 11))


def bright_cells(size: int = 64, cell: int = 8, box: int = 12) -> bytes:
    """A detector with the input and output of YOLOv8: a box about every cell, scored by its red and its blue.

    Parameters
    ----------
    size, cell
        px: width and height of the input, and of its cells.
    box
        px: width and height of the boxes, which overlap when they are larger than cells.
    """
    n_cells = size // cell
    colours = np.zeros((6, 3), np.float32)  # rows: centre, size, and the scores of two classes; columns: RGB
    colours[4, 0] = colours[5, 2] = 1
    places = np.zeros((6, n_cells, n_cells), np.float32)
    places[1], places[0] = (np.indices((n_cells, n_cells)) + 0.5) * cell
    places[2:4] = box
    return _over_cells(colours, places, size)


def steady_person(points: NDArray[np.float32], size: int = 64) -> bytes:
    """A detector with the input and output of YOLOv8-pose: it finds one person, at one place in all images.

    Parameters
    ----------
    points
        `(17, 3)`: x, y px of the input, and score, in COCO's order.
    size
        px: width and height of the input.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    row = np.concatenate([(low + high) / 2, high - low, [0.9], points.ravel()]).astype(np.float32)
    return _over_cells(np.zeros((len(row), 3), np.float32), row[:, None, None], size)


def _over_cells(colours: NDArray[np.float32], places: NDArray[np.float32], size: int) -> bytes:
    """Rows for all cells of an image: sums of their mean colours, and what is there anyway.

    Parameters
    ----------
    colours
        `(rows, 3)`: what is made of red, green and blue.
    places
        `(rows, n_cells, n_cells)`.
    size
        px: width and height of the input.
    """
    rows, n_cells = places.shape[:2]
    cell = size // n_cells
    kernel = _list("kernel_shape", cell, cell) + _list("strides", cell, cell)
    nodes = _node("AveragePool", ["images"], "cells", kernel)
    nodes += _node("Conv", ["cells", "colours"], "scores", _list("kernel_shape", 1, 1))
    nodes += _node("Add", ["scores", "places"], "all", b"")
    nodes += _node("Reshape", ["all", "shape"], "output0", b"")
    weights = _field(5, _tensor("colours", [rows, 3, 1, 1], FLOAT, colours.tobytes()))
    weights += _field(5, _tensor("places", [1, *places.shape], FLOAT, places.tobytes()))
    weights += _field(5, _tensor("shape", [3], INT64, struct.pack("<3q", 1, rows, n_cells**2)))
    result = _field(12, _value("output0", [1, rows, n_cells**2]))
    graph = nodes + _field(2, b"g") + weights + _field(11, _value("images", [1, 3, size, size])) + result
    return _number(1, 6) + _field(7, graph) + _field(8, _field(1, b"") + _number(2, 11))


def _node(kind: str, inputs: list[str], output: str, attributes: bytes) -> bytes:
    fed = b"".join(_field(1, name.encode()) for name in inputs)
    name = output.encode()
    return _field(1, fed + _field(2, name) + _field(3, name) + _field(4, kind.encode()) + attributes)


def _list(name: str, *numbers: int) -> bytes:
    content = _field(1, name.encode()) + b"".join(_number(8, number) for number in numbers)
    return _field(5, content + _number(20, LIST))


def _tensor(name: str, shape: list[int], kind: int, data: bytes) -> bytes:
    sizes = b"".join(_number(1, size) for size in shape)
    return sizes + _number(2, kind) + _field(8, name.encode()) + _field(9, data)


def _value(name: str, shape: list[int]) -> bytes:
    sizes = b"".join(_field(1, _number(1, size)) for size in shape)
    kind = _field(1, _number(1, FLOAT) + _field(2, sizes))
    return _field(1, name.encode()) + _field(2, kind)


def _number(field: int, value: int) -> bytes:
    """A number of a protocol buffer."""
    return _varint(field << 3) + _varint(value)


def _field(field: int, content: bytes) -> bytes:
    """Bytes, text or a message of a protocol buffer."""
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    content = bytearray()
    while value > 127:
        content.append(value & 127 | 128)
        value >>= 7
    return bytes([*content, value])
