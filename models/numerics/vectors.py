"""Whole vectors in kernels, where a compiler that cannot tell arrays apart would go number by number."""

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba.np.numpy_support import carray

from .compiled import inlined, llvm_code

Function = Callable[..., Any]

LANES = 16
"""Numbers of a vector."""

MOST = 256
"""Numbers that an array of a loop's own holds."""

_FLOATS = ir.VectorType(ir.FloatType(), LANES)


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), ir.PointerType(_FLOATS))


def _everywhere(builder: Any, number: Any) -> Any:
    first = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(
        first, first, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    )


def _adding(terms: int) -> Function:
    def typed(typing_context: Any, target: Any, at: Any, *products: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            kinds = signature.args
            where = _place(context, builder, kinds[0], arguments[0], arguments[1])
            total = builder.load(where, align=4)
            for first in range(2, 2 + 3 * terms, 3):
                factor, array, index = arguments[first : first + 3]
                source = builder.load(_place(context, builder, kinds[first + 1], array, index), align=4)
                product = builder.fmul(_everywhere(builder, factor), source, flags=("fast",))
                total = builder.fadd(total, product, flags=("fast",))
            builder.store(total, where, align=4)
            return context.get_dummy_value()

        index, number = numba.types.intp, numba.types.float32
        parts = [part for k in range(terms) for part in (number, products[3 * k + 1], index)]
        return numba.types.void(target, index, *parts), generate

    return typed


@llvm_code
def add_vector(typing_context: Any, target: Any, at: Any, a: Any, x: Any, i: Any) -> Any:
    """Add a x[i : i + 16] to target[at : at + 16]; float32, 1-D."""
    return _adding(1)(typing_context, target, at, a, x, i)


@llvm_code
def add_vectors(
    typing_context: Any, target: Any, at: Any, a: Any, x: Any, i: Any, b: Any, y: Any, j: Any
) -> Any:
    """Add a x[i : i + 16] + b y[j : j + 16] to target[at : at + 16]; float32, 1-D."""
    return _adding(2)(typing_context, target, at, a, x, i, b, y, j)


@llvm_code
def _on_stack(typing_context: Any, kind: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        room = ir.ArrayType(context.get_value_type(kind.dtype), MOST)
        with builder.goto_entry_block():
            return builder.bitcast(builder.alloca(room), ir.PointerType(room.element))

    pointer: Any = numba.types.CPointer
    return pointer(kind.dtype)(kind), generate


@inlined
def own_array(kind: Any) -> Any:
    """A 1-D array of `MOST` numbers of a `kind`, on the stack: nothing else can be in its place.

    Loops that write to such arrays only are vectorised without asking whether they overlap with what is read.
    """
    return carray(_on_stack(kind), (MOST,))
