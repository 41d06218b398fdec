"""Four float32 at once, for kernels: the channels of a pixel, loaded, added, multiplied and stored as one vector.

The compiler makes vectors of loops only where Numba calls it, and a pixel's four channels are too short a loop; written
out, they stay four scalars each. A vector is a tuple of four here, which the compiler keeps in one register. Every
function exists twice: as plain Python, which is what it means and what runs where compilation is off, and as the
instruction that takes its place in compiled code. Results are the same bit by bit: nothing is contracted or reordered.
"""

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload

LANES = 4

_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_TUPLE = types.UniTuple(types.float32, LANES)
_FLAT = types.Array(types.float32, 1, "C")
_FLOAT_BYTES = 4


def load(array, index):
    """Return elements ``index`` to ``index + 3`` of a flat, contiguous float32 array; index is unsigned."""
    return array[index], array[index + np.uint64(1)], array[index + np.uint64(2)], array[index + np.uint64(3)]


def store(array, index, vector):
    """Write a vector to elements ``index`` to ``index + 3`` of a flat, contiguous float32 array."""
    for lane in range(LANES):
        array[index + np.uint64(lane)] = vector[lane]


def add(x, y):
    """Return the sum of two vectors."""
    return tuple(a + b for a, b in zip(x, y, strict=True))


def multiply(x, y):
    """Return the product of two vectors, element by element."""
    return tuple(a * b for a, b in zip(x, y, strict=True))


def _lane(number):
    return ir.Constant(ir.IntType(32), number)


def _pack(builder, members):
    """Make a vector of a tuple; the compiler drops the two conversions where a tuple has just been a vector."""
    vector = ir.Constant(_VECTOR, ir.Undefined)
    for lane in range(LANES):
        vector = builder.insert_element(vector, builder.extract_value(members, lane), _lane(lane))
    return vector


def _unpack(context, builder, vector):
    members = [builder.extract_element(vector, _lane(lane)) for lane in range(LANES)]
    return context.make_tuple(builder, _TUPLE, members)


def _place(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


@intrinsic
def _load(typing_context, array, index):
    def code(context, builder, signature, arguments):
        place = _place(context, builder, signature.args[0], *arguments)
        return _unpack(context, builder, builder.load(place, align=_FLOAT_BYTES))

    return _TUPLE(array, index), code


@intrinsic
def _store(typing_context, array, index, vector):
    def code(context, builder, signature, arguments):
        place = _place(context, builder, signature.args[0], *arguments[:2])
        builder.store(_pack(builder, arguments[2]), place, align=_FLOAT_BYTES)
        return context.get_dummy_value()

    return types.void(array, index, vector), code


@intrinsic
def _add(typing_context, x, y):
    def code(context, builder, signature, arguments):
        return _unpack(context, builder, builder.fadd(*(_pack(builder, each) for each in arguments)))

    return _TUPLE(x, y), code


@intrinsic
def _multiply(typing_context, x, y):
    def code(context, builder, signature, arguments):
        return _unpack(context, builder, builder.fmul(*(_pack(builder, each) for each in arguments)))

    return _TUPLE(x, y), code


@overload(load)
def _compiled_load(array, index):
    # Any other array has no such function, which is an error when a kernel is compiled.
    return (lambda array, index: _load(array, index)) if array == _FLAT else None


@overload(store)
def _compiled_store(array, index, vector):
    return (lambda array, index, vector: _store(array, index, vector)) if array == _FLAT else None


@overload(add)
def _compiled_add(x, y):
    return lambda x, y: _add(x, y)


@overload(multiply)
def _compiled_multiply(x, y):
    return lambda x, y: _multiply(x, y)
