"""Differences of a track from the map over a lattice of shifts, eight shifts at a time.

numba has no vector type; this module makes one of LLVM's, so that the sums of a tile of shifts (four rows by eight
columns) stay in registers while the track's points go by. Loops that keep the sums in memory take up to twice as long.

Only compiled: without numba's compiler :mod:`app.engine.kernels.contour` does the same in plain loops.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

ROWS, LANES = 4, 8
"""Shifts of a tile; a lattice has whole tiles."""
_VECTOR = ir.VectorType(ir.FloatType(), LANES)


class _Lanes(types.Type):  # type: ignore[misc]
    """``LANES`` float32 values in registers."""

    def __init__(self) -> None:
        super().__init__(name=f"Float32Lanes{LANES}")


_LANES = _Lanes()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, front_end_type: Any) -> None:
        super().__init__(manager, front_end_type, _VECTOR)


def _pointer(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.bitcast(builder.gep(array.data, [arguments[1]]), _VECTOR.as_pointer())


def _call(builder: Any, name: str, *arguments: Any) -> Any:
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(arguments))
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32")
    return builder.call(function, arguments)


@intrinsic
def _load(typing_context, array, at):
    """Lanes that begin at a flat position of a contiguous array."""

    def generate(context, builder, signature, arguments):
        value = builder.load(_pointer(context, builder, signature, arguments))
        value.align = 4
        return value

    return _LANES(array, types.intp), generate


@intrinsic
def _store(typing_context, array, at, lanes):
    """Write lanes there."""

    def generate(context, builder, signature, arguments):
        builder.store(arguments[2], _pointer(context, builder, signature, arguments)).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), generate


@intrinsic
def _splat(typing_context, scalar):
    """All lanes alike."""

    def generate(context, builder, signature, arguments):
        empty = ir.Constant(_VECTOR, ir.Undefined)
        first = builder.insert_element(empty, arguments[0], ir.Constant(ir.IntType(32), 0))
        everywhere = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(first, empty, everywhere)

    return _LANES(types.float32), generate


@intrinsic
def _add(typing_context, a, b):
    """``a + b``."""
    return _LANES(a, b), lambda context, builder, signature, arguments: builder.fadd(*arguments)


@intrinsic
def _sub(typing_context, a, b):
    """``a - b``."""
    return _LANES(a, b), lambda context, builder, signature, arguments: builder.fsub(*arguments)


@intrinsic
def _muladd(typing_context, a, b, c):
    """``a b + c``, in one operation where the processor has it."""
    return _LANES(a, b, c), lambda context, builder, signature, arguments: _call(builder, "fmuladd", *arguments)


@intrinsic
def _absolute(typing_context, a):
    """``|a|``."""
    return _LANES(a), lambda context, builder, signature, arguments: _call(builder, "fabs", *arguments)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _gather(total, d, weight, at, squared):
    """Add ``w |d|`` or ``w d^2`` to a sum of lanes."""
    if weight is None:
        if squared:
            return _muladd(d, d, total)
        return _add(total, _absolute(d))
    w = _load(weight, at)
    if squared:
        return _muladd(_muladd(d, d, _splat(np.float32(0.0))), w, total)
    return _muladd(_absolute(d), w, total)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _along(plane, at, g):
    """Map between two columns."""
    left = _load(plane, at)
    return _muladd(g, _sub(_load(plane, at + 1), left), left)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def lattice_difference(plane, weight, offset, below, near, v, u, z, squared, total):
    """Add sums of ``|s - z|`` or ``(s - z)^2`` over the points, for each shift.

    Parameters
    ----------
    plane : (rows, columns) float32, one channel of the map
    weight : (rows, columns) float32, of the node nearest to a point; or None: all count alike
    offset : (shift rows, shift columns) float32, added to the map at each shift; or None
    below, near : (n,) int64, flat index of the node below each point at the first shift, and of the nearest one
    v, u : (n,) float32, fraction of a cell beyond the node below, towards the next row and column
    z : (n,) float32, readings
    squared : bool
    total : (shift rows, shift columns) float32, added to; whole tiles of ROWS x LANES
    """
    rows, columns = total.shape
    stride = plane.shape[1]
    one, zero = np.float32(1.0), _splat(np.float32(0.0))
    for y in range(0, rows, ROWS):
        for x in range(0, columns, LANES):
            t0, t1, t2, t3 = zero, zero, zero, zero
            b0, b1, b2, b3 = zero, zero, zero, zero
            at = y * columns + x
            if offset is not None:
                b0, b1 = _load(offset, at), _load(offset, at + columns)
                b2, b3 = _load(offset, at + 2 * columns), _load(offset, at + 3 * columns)
            for k in range(z.shape[0]):
                p = below[k] + y * stride + x
                q = near[k] + y * stride + x
                f, e, g, c = _splat(v[k]), _splat(one - v[k]), _splat(u[k]), _splat(-z[k])
                h = _along(plane, p, g)
                d = _muladd(e, h, c)
                h = _along(plane, p + stride, g)
                d = _muladd(f, h, d)
                if offset is not None:
                    d = _add(d, b0)
                t0 = _gather(t0, d, weight, q, squared)
                d = _muladd(e, h, c)
                h = _along(plane, p + 2 * stride, g)
                d = _muladd(f, h, d)
                if offset is not None:
                    d = _add(d, b1)
                t1 = _gather(t1, d, weight, q + stride, squared)
                d = _muladd(e, h, c)
                h = _along(plane, p + 3 * stride, g)
                d = _muladd(f, h, d)
                if offset is not None:
                    d = _add(d, b2)
                t2 = _gather(t2, d, weight, q + 2 * stride, squared)
                d = _muladd(e, h, c)
                h = _along(plane, p + 4 * stride, g)
                d = _muladd(f, h, d)
                if offset is not None:
                    d = _add(d, b3)
                t3 = _gather(t3, d, weight, q + 3 * stride, squared)
            _store(total, at, _add(_load(total, at), t0))
            _store(total, at + columns, _add(_load(total, at + columns), t1))
            _store(total, at + 2 * columns, _add(_load(total, at + 2 * columns), t2))
            _store(total, at + 3 * columns, _add(_load(total, at + 3 * columns), t3))
