"""Four float32 at once, for kernels: the channels of a pixel, loaded, added, multiplied and stored as one vector.

Eight at once are those of two pixels: what is done with many neighbours alike takes half as long.

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
TWO_PIXELS = 2 * LANES

_FLAT = types.Array(types.float32, 1, "C")
_FLOAT_BYTES = 4


def load(array, index):
    """Return elements ``index`` to ``index + 3`` of a flat, contiguous float32 array; index is unsigned."""
    return _elements(array, index, LANES)


def load_two(array, index):
    """Return elements ``index`` to ``index + 7``: two pixels."""
    return _elements(array, index, TWO_PIXELS)


def _elements(array, index, count):
    return tuple(array[index + np.uint64(lane)] for lane in range(count))


def store(array, index, vector):
    """Write a vector, of one pixel or two, to the elements from ``index`` on of a flat, contiguous float32 array."""
    for lane, value in enumerate(vector):
        array[index + np.uint64(lane)] = value


def add(x, y):
    """Return the sum of two vectors."""
    return tuple(a + b for a, b in zip(x, y, strict=True))


def multiply(x, y):
    """Return the product of two vectors, element by element."""
    return tuple(a * b for a, b in zip(x, y, strict=True))


def _lane(number):
    return ir.Constant(ir.IntType(32), number)


def _vector(lanes):
    return ir.VectorType(ir.FloatType(), lanes)


def _pack(builder, members, lanes):
    """Make a vector of a tuple; the compiler drops the two conversions where a tuple has just been a vector."""
    vector = ir.Constant(_vector(lanes), ir.Undefined)
    for lane in range(lanes):
        vector = builder.insert_element(vector, builder.extract_value(members, lane), _lane(lane))
    return vector


def _unpack(context, builder, kind, vector):
    members = [builder.extract_element(vector, _lane(lane)) for lane in range(kind.count)]
    return context.make_tuple(builder, kind, members)


def _place(context, builder, array_type, array, index, lanes):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _vector(lanes).as_pointer())


def _loader(lanes):
    """Return what loads so many elements, for compiled code."""
    kind = types.UniTuple(types.float32, lanes)

    @intrinsic
    def read(typing_context, array, index):
        def code(context, builder, signature, arguments):
            place = _place(context, builder, signature.args[0], *arguments, lanes)
            return _unpack(context, builder, kind, builder.load(place, align=_FLOAT_BYTES))

        return kind(array, index), code

    return read


_load, _load_two = _loader(LANES), _loader(TWO_PIXELS)


@intrinsic
def _store(typing_context, array, index, vector):
    def code(context, builder, signature, arguments):
        lanes = signature.args[2].count
        place = _place(context, builder, signature.args[0], *arguments[:2], lanes)
        builder.store(_pack(builder, arguments[2], lanes), place, align=_FLOAT_BYTES)
        return context.get_dummy_value()

    return types.void(array, index, vector), code


@intrinsic
def _add(typing_context, x, y):
    def code(context, builder, signature, arguments):
        added = builder.fadd(*(_pack(builder, each, x.count) for each in arguments))
        return _unpack(context, builder, x, added)

    return x(x, y), code


@intrinsic
def _multiply(typing_context, x, y):
    def code(context, builder, signature, arguments):
        product = builder.fmul(*(_pack(builder, each, x.count) for each in arguments))
        return _unpack(context, builder, x, product)

    return x(x, y), code


@overload(load)
def _compiled_load(array, index):
    # Any other array has no such function, which is an error when a kernel is compiled.
    return (lambda array, index: _load(array, index)) if array == _FLAT else None


@overload(load_two)
def _compiled_load_two(array, index):
    return (lambda array, index: _load_two(array, index)) if array == _FLAT else None


@overload(store)
def _compiled_store(array, index, vector):
    return (lambda array, index, vector: _store(array, index, vector)) if array == _FLAT else None


@overload(add)
def _compiled_add(x, y):
    return lambda x, y: _add(x, y)


@overload(multiply)
def _compiled_multiply(x, y):
    return lambda x, y: _multiply(x, y)
