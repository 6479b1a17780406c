"""Short vectors for the packed rows of the tangent, (edges, 12); see `sparse_products`."""

from collections.abc import Sequence

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.base import BaseContext
from numba.core.typing import Context, Signature
from numba.extending import intrinsic

from palpate.workers.mechanics.fem.elements.simd import (
    FUSED,
    INDEX,
    Intrinsic,
    Vector,
    as_index,
    llvm,
    load_at,
    place,
    zeros,
)

# A packed edge of the tangent: three rows of (K, K, K, B).
EDGE = 12


@intrinsic
def edge_zero(typing: Context, x: types.Array) -> Intrinsic:
    """Return an empty sum over edges, in the precision of the array `x`."""
    vector = Vector(x.dtype, EDGE)
    return vector(x), lambda context, builder, signature, arguments: zeros(vector)


@intrinsic
def edge_add(
    typing: Context,
    total: Vector,
    rows: types.Array,
    q: types.Integer,
    x: types.Array,
    j: types.Integer,
) -> Intrinsic:
    """Return ``total + rows[q] * (x[j], x[j], x[j])``; `rows` is (edges, 12), `x` (n, 4)."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        total_, rows_, q_, x_, j_ = arguments
        wide = llvm(total)
        first = builder.mul(as_index(builder, q_), INDEX(EDGE))
        stored = ir.VectorType(ir.FloatType(), EDGE)
        at = place(context, builder, rows, rows_, first, stored)
        edge = load_at(builder, at, types.float32)
        if total.dtype != types.float32:
            edge = builder.fpext(edge, wide)
        first = builder.mul(as_index(builder, j_), INDEX(4))
        four = llvm(Vector(total.dtype, 4))
        at = load_at(builder, place(context, builder, x, x_, first, four), total.dtype)
        thrice = ir.Constant(ir.VectorType(ir.IntType(32), EDGE), [0, 1, 2, 3] * 3)
        at = builder.shuffle_vector(at, ir.Constant(four, ir.Undefined), thrice)
        return builder.fadd(total_, builder.fmul(edge, at, flags=FUSED), flags=FUSED)

    return total(total, rows, q, x, j), generate


@intrinsic
def edge_sums(typing: Context, total: Vector) -> Intrinsic:
    """Return the three sums of four neighbours, as a tuple."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        def item(k: int) -> ir.Value:
            return builder.extract_element(arguments[0], ir.IntType(32)(k))

        sums = [
            builder.fadd(
                builder.fadd(item(4 * a), item(4 * a + 2)),
                builder.fadd(item(4 * a + 1), item(4 * a + 3)),
            )
            for a in range(3)
        ]
        return context.make_tuple(builder, sig.return_type, sums)

    return types.UniTuple(total.dtype, 3)(total), generate


@intrinsic
def store_interleaved(
    typing: Context,
    lines: types.Array,
    line: types.Integer,
    a: Vector,
    b: Vector,
    c: Vector,
    d: Vector,
) -> Intrinsic:
    """Store lane l of four vectors side by side into ``lines[l, 4 line : 4 line + 4]``.

    `lines` is (lanes, numbers) in single precision.
    """

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        n = a.width
        single = ir.VectorType(ir.FloatType(), n)
        pairs = [builder.fptrunc(value, single) for value in arguments[2:]]
        two = [_joined(builder, *pairs[:2]), _joined(builder, *pairs[2:])]
        four = _joined(builder, *two)
        width = builder.extract_value(
            context.make_array(lines)(context, builder, value=arguments[0]).shape, 1
        )
        column = builder.mul(as_index(builder, arguments[1]), INDEX(4))
        for lane in range(n):
            pick = ir.Constant(ir.VectorType(ir.IntType(32), 4), [lane + n * k for k in range(4)])
            value = builder.shuffle_vector(four, ir.Constant(four.type, ir.Undefined), pick)
            item = builder.add(builder.mul(width, INDEX(lane)), column)
            to = place(context, builder, lines, arguments[0], item, value.type)
            builder.store(value, to).align = 4
        return context.get_dummy_value()

    return types.void(lines, line, a, b, c, d), generate


def _joined(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    """Return the lanes of two vectors one after another."""
    count = 2 * a.type.count
    every = ir.Constant(ir.VectorType(ir.IntType(32), count), list(range(count)))
    return builder.shuffle_vector(a, b, every)


@intrinsic
def add_edge(
    typing: Context,
    rows: types.Array,
    q: types.Integer,
    lines: types.Array,
    lane: types.Integer,
    k: types.Integer,
) -> Intrinsic:
    """Add ``lines[lane, 12 k : 12 k + 12]`` to ``rows[q]``, all in single precision."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        rows_, q_, lines_, lane_, k_ = arguments
        twelve = ir.VectorType(ir.FloatType(), EDGE)
        width = builder.extract_value(
            context.make_array(lines)(context, builder, value=lines_).shape, 1
        )
        item = builder.mul(as_index(builder, lane_), width)
        item = builder.add(item, builder.mul(as_index(builder, k_), INDEX(EDGE)))
        more = load_at(builder, place(context, builder, lines, lines_, item, twelve), types.float32)
        first = builder.mul(as_index(builder, q_), INDEX(EDGE))
        to = place(context, builder, rows, rows_, first, twelve)
        total = builder.fadd(load_at(builder, to, types.float32), more)
        builder.store(total, to).align = 4
        return context.get_dummy_value()

    return types.void(rows, q, lines, lane, k), generate


@intrinsic
def fetch_edge(typing: Context, rows: types.Array, q: types.Integer) -> Intrinsic:
    """Prefetch ``rows[q]`` for writing."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        byte = ir.IntType(8).as_pointer()
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        first = builder.mul(as_index(builder, arguments[1]), INDEX(EDGE))
        at = place(context, builder, rows, arguments[0], first, ir.FloatType())
        builder.call(prefetch, [builder.bitcast(at, byte), number(1), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(rows, q), generate
