"""Short vectors for compiled loops: several numbers added and multiplied in one instruction.

The loop over a row of the tangent is too short, and writes too near to where it
reads, for the compiler to vectorise. These few operations say it outright; what
a processor lacks (512, 256 bits), LLVM splits into what it has. A `Vector`
lives inside a compiled function only, in registers.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic, models, register_model

# Right-hand sides that travel together: 16 floats fill the widest register.
LANES = 16
# A packed edge of the tangent: three rows of (K, K, K, B).
EDGE = 12

_FUSED = ("contract", "nsz")
_INDEX = ir.IntType(64)

# What an intrinsic returns: its signature, and how to write it down.
Intrinsic = tuple[Any, Callable[[Any, Any, Any, Any], Any]]


class Vector(types.Type):
    """`width` numbers of a type, side by side."""

    def __init__(self, dtype: types.Float, width: int) -> None:
        self.dtype, self.width = dtype, width
        super().__init__(name=f"Vector({dtype}, {width})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, _llvm(vector))


def _llvm(vector: Vector) -> ir.VectorType:
    number = ir.FloatType() if vector.dtype == types.float32 else ir.DoubleType()
    return ir.VectorType(number, vector.width)


def _place(context: Any, builder: Any, array_type: Any, array: Any, item: Any, vector: Any) -> Any:
    """Where a vector begins that starts with number `item` of a contiguous array."""
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [item]), vector.as_pointer())


def _load(builder: Any, place: Any, dtype: types.Float) -> Any:
    vector = builder.load(place)
    vector.align = dtype.bitwidth // 8
    return vector


def _as_index(builder: Any, number: Any) -> Any:
    return number if number.type.width == 64 else builder.zext(number, _INDEX)


def _zero(vector: Vector) -> Any:
    return ir.Constant(_llvm(vector), [0.0] * vector.width)


@intrinsic
def edge_zero(typing: Any, x: Any) -> Intrinsic:
    """An empty sum over edges, in the precision of the array `x`."""
    vector = Vector(x.dtype, EDGE)
    return vector(x), lambda context, builder, signature, arguments: _zero(vector)


@intrinsic
def edge_add(typing: Any, total: Any, rows: Any, q: Any, x: Any, j: Any) -> Intrinsic:
    """``total + rows[q] * (x[j], x[j], x[j])``: `rows` is (edges, 12) float32, `x` (n, 4)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        total_, rows_, q_, x_, j_ = arguments
        wide = _llvm(total)
        first = builder.mul(_as_index(builder, q_), _INDEX(EDGE))
        stored = ir.VectorType(ir.FloatType(), EDGE)
        place = _place(context, builder, rows, rows_, first, stored)
        edge = _load(builder, place, types.float32)
        if total.dtype != types.float32:
            edge = builder.fpext(edge, wide)
        first = builder.mul(_as_index(builder, j_), _INDEX(4))
        four = _llvm(Vector(total.dtype, 4))
        at = _load(builder, _place(context, builder, x, x_, first, four), total.dtype)
        thrice = ir.Constant(ir.VectorType(ir.IntType(32), EDGE), [0, 1, 2, 3] * 3)
        at = builder.shuffle_vector(at, ir.Constant(four, ir.Undefined), thrice)
        return builder.fadd(total_, builder.fmul(edge, at, flags=_FUSED), flags=_FUSED)

    return total(total, rows, q, x, j), generate


@intrinsic
def edge_sums(typing: Any, total: Any) -> Intrinsic:
    """The three sums of four neighbours, as a tuple."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def item(k: int) -> Any:
            return builder.extract_element(arguments[0], ir.IntType(32)(k))

        sums = [
            builder.fadd(
                builder.fadd(item(4 * a), item(4 * a + 2)),
                builder.fadd(item(4 * a + 1), item(4 * a + 3)),
            )
            for a in range(3)
        ]
        return context.make_tuple(builder, signature.return_type, sums)

    return types.UniTuple(total.dtype, 3)(total), generate


@intrinsic
def zero(typing: Any, x: Any) -> Intrinsic:
    """Zero in each lane, in the precision of the array `x`."""
    vector = Vector(x.dtype, LANES)
    return vector(x), lambda context, builder, signature, arguments: _zero(vector)


@intrinsic
def load(typing: Any, x: Any, k: Any) -> Intrinsic:
    """The lanes of row `k` of `x`, a contiguous array seen as (rows, LANES)."""
    vector = Vector(x.dtype, LANES)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first = builder.mul(_as_index(builder, arguments[1]), _INDEX(LANES))
        place = _place(context, builder, x, arguments[0], first, _llvm(vector))
        return _load(builder, place, x.dtype)

    return vector(x, k), generate


@intrinsic
def store(typing: Any, x: Any, k: Any, value: Any) -> Intrinsic:
    """Put `value` into row `k` of `x`; see `load`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first = builder.mul(_as_index(builder, arguments[1]), _INDEX(LANES))
        place = _place(context, builder, x, arguments[0], first, _llvm(value))
        builder.store(arguments[2], place).align = x.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(x, k, value), generate


@intrinsic
def fma(typing: Any, total: Any, a: Any, b: Any) -> Intrinsic:
    """``total + a * b``; `a` is a vector or a number for all lanes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        total_, a_, b_ = arguments
        if not isinstance(a, Vector):
            a_ = context.cast(builder, a_, a, total.dtype)
            a_ = _splat(builder, a_, _llvm(total))
        return builder.fadd(total_, builder.fmul(a_, b_, flags=_FUSED), flags=_FUSED)

    return total(total, a, b), generate


def _splat(builder: Any, number: Any, vector: ir.VectorType) -> Any:
    empty = ir.Constant(vector, ir.Undefined)
    one = builder.insert_element(empty, number, ir.IntType(32)(0))
    first = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(one, empty, first)
