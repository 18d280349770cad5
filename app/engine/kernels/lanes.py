"""Values of 32 lanes for numba kernels: one number of each of 32 sequences, worked on together.

numba has no vector type, and LLVM's own vectorizer stops at the minimum of three neighbours that dynamic programming
carries from cell to cell. Here LLVM's vector types are made a numba type: 32 float32 are four, 32 uint16 two registers
of AVX2, enough independent work to hide the latency of each operation. Other processors get as many instructions as
their registers need.

The lane type follows from the array's: :func:`load` of a float32 array gives 32 floats, of a uint16 array 32 words.
Offsets count elements from the array's first; nothing is checked, and arrays must be contiguous. uint16 saturates: sums
stay at 65535 and differences at 0, so that "unreachable" plus any cost is unreachable still.

These work in compiled code only; there is nothing to run them with when numba's compiler is off.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

LANES = 32
FAR: dict[str, Any] = {"float32": np.float32(1e30), "uint16": np.uint16(65535)}
"""Unreachable: larger than every cost, and still finite, as fast math wants it."""

_ELEMENT = {types.float32: ir.FloatType(), types.uint16: ir.IntType(16)}
_SUFFIX = {types.float32: f"v{LANES}f32", types.uint16: f"v{LANES}i16"}


class LanesType(types.Type):  # type: ignore[misc]
    """Numba type of 32 values of one scalar type."""

    def __init__(self, scalar: types.Type) -> None:
        super().__init__(name=f"Lanes({scalar})")
        self.scalar = scalar

    @property
    def key(self):
        """Types of equal keys are one type."""
        return self.scalar


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager, lanes):
        super().__init__(manager, lanes, _vector(lanes.scalar))


def _vector(scalar):
    return ir.VectorType(_ELEMENT[scalar], LANES)


def _pointer(context, builder, array_type, array, offset):
    """Address of an array's element, and the alignment that it has for certain."""
    data = context.make_array(array_type)(context, builder, array).data
    at = builder.gep(data, [offset], inbounds=True)
    return builder.bitcast(at, _vector(array_type.dtype).as_pointer()), array_type.dtype.bitwidth // 8


def _in_all(builder, scalar, number):
    index = ir.IntType(32)
    one = builder.insert_element(ir.Constant(_vector(scalar), ir.Undefined), number, index(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(index, LANES), [0] * LANES))


def _call(builder, name, scalar, arguments):
    vector = _vector(scalar)
    kind = ir.FunctionType(vector, [vector] * len(arguments))
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.{_SUFFIX[scalar]}")
    return builder.call(function, arguments)


def _minimum(builder, scalar, a, b):
    if scalar is types.float32:
        return builder.select(builder.fcmp_ordered("<", a, b, flags=("fast",)), a, b)
    return builder.select(builder.icmp_unsigned("<", a, b), a, b)


@intrinsic
def load(_typing, array, offset):  # noqa: ARG001
    """32 elements from ``offset`` on."""
    if not (isinstance(array, types.Array) and array.dtype in _ELEMENT):
        return None

    def generate(context, builder, signature, arguments):
        pointer, align = _pointer(context, builder, signature.args[0], *arguments)
        value = builder.load(pointer)
        value.align = align
        return value

    return LanesType(array.dtype)(array, types.intp), generate


@intrinsic
def store(_typing, array, offset, value):  # noqa: ARG001
    """Write 32 elements from ``offset`` on."""

    def generate(context, builder, signature, arguments):
        pointer, align = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], pointer).align = align
        return context.get_dummy_value()

    return types.void(array, types.intp, value), generate


@intrinsic
def splat(_typing, like, scalar):
    """One number in all lanes, of the type of the array ``like``."""

    def generate(context, builder, signature, arguments):
        number = context.cast(builder, arguments[1], signature.args[1], like.dtype)
        return _in_all(builder, like.dtype, number)

    return LanesType(like.dtype)(like, scalar), generate


@intrinsic
def unreachable(_typing, like):
    """:data:`FAR` in all lanes, of the type of the array ``like``."""

    def generate(_context, _builder, _signature, _arguments):
        return ir.Constant(_vector(like.dtype), [FAR[str(like.dtype)].item()] * LANES)

    return LanesType(like.dtype)(like), generate


@intrinsic
def minimum(_typing, a, b):
    """Lesser of two, lane by lane."""

    def generate(_context, builder, signature, arguments):
        return _minimum(builder, signature.return_type.scalar, *arguments)

    return a(a, b), generate


@intrinsic
def add(_typing, a, b):
    """Sum, saturating for words."""

    def generate(_context, builder, signature, arguments):
        if signature.return_type.scalar is types.float32:
            return builder.fadd(*arguments, flags=("fast",))
        return _call(builder, "uadd.sat", types.uint16, arguments)

    return a(a, b), generate


@intrinsic
def subtract(_typing, a, b):
    """Difference; of words, zero where it would be negative."""

    def generate(_context, builder, signature, arguments):
        if signature.return_type.scalar is types.float32:
            return builder.fsub(*arguments, flags=("fast",))
        return _call(builder, "usub.sat", types.uint16, arguments)

    return a(a, b), generate


@intrinsic
def distance(_typing, a, b):
    """Absolute difference."""

    def generate(_context, builder, signature, arguments):
        a, b = arguments
        if signature.return_type.scalar is types.float32:
            return _call(builder, "fabs", types.float32, [builder.fsub(a, b, flags=("fast",))])
        # of the two saturating differences one is zero
        forth, back = (_call(builder, "usub.sat", types.uint16, pair) for pair in ([a, b], [b, a]))
        return builder.or_(forth, back)

    return a(a, b), generate


@intrinsic
def add_cost(_typing, total, a, b):
    """``total`` plus the cost of matching ``a`` with ``b``: squared difference of floats, absolute one of words.

    The square of a word does not fit into a word; for floats it saves an instruction over the absolute value.
    """

    def generate(_context, builder, signature, arguments):
        total, a, b = arguments
        if signature.return_type.scalar is types.float32:
            apart = builder.fsub(a, b, flags=("fast",))
            return _call(builder, "fma", types.float32, [apart, apart, total])
        forth, back = (_call(builder, "usub.sat", types.uint16, pair) for pair in ([a, b], [b, a]))
        return _call(builder, "uadd.sat", types.uint16, [total, builder.or_(forth, back)])

    return total(total, a, b), generate
