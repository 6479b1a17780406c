"""Short vectors for compiled loops: several numbers added and multiplied in one instruction.

The loop over a row of the tangent is too short, and writes too close to its reads, for
the compiler to vectorise; assembly is one long sequence for each element. A `Vector`
explicitly processes `LANES` items at once: right-hand sides in `sparse_products`,
elements in `tangent_assembly`. It adds, subtracts, multiplies and divides with vectors and
numbers. LLVM splits widths that a processor lacks (512, 256 bits). A `Vector` exists
only inside a compiled function, in registers.

The packed rows of the tangent, (edges, 12), have short vectors of their own: one edge is read,
added to and stored at once; see `sparse_products`.
"""

import operator
from collections.abc import Callable, Sequence

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.base import BaseContext
from numba.core.datamodel.manager import DataModelManager
from numba.core.typing import Context, Signature
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

# Eight doubles fill the widest register; sixteen at once gained a tenth on full blocks
# and lost up to half on others.
LANES = 8

FUSED = ("contract", "nsz")
INDEX = ir.IntType(64)

Generator = Callable[[BaseContext, ir.IRBuilder, Signature, Sequence[ir.Value]], ir.Value]
Intrinsic = tuple[Signature, Generator]
"""Result of an intrinsic: its signature and its code generator."""


class Vector(types.Type):
    """Type of `width` adjacent numbers."""

    def __init__(self, dtype: types.Float, width: int) -> None:
        self.dtype, self.width = dtype, width
        super().__init__(name=f"Vector({dtype}, {width})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    """Data model of a `Vector`: LLVM's own type."""

    def __init__(self, manager: DataModelManager, vector: Vector) -> None:
        super().__init__(manager, vector, llvm(vector))


def llvm(vector: Vector) -> ir.VectorType:
    """Return LLVM's type of a vector."""
    number = ir.FloatType() if vector.dtype == types.float32 else ir.DoubleType()
    return ir.VectorType(number, vector.width)


def place(
    context: BaseContext,
    builder: ir.IRBuilder,
    array_type: types.Array,
    array: ir.Value,
    item: ir.Value,
    stored: ir.Type,
) -> ir.Value:
    """Return the address of number `item` of a contiguous array, as a pointer to `stored`."""
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [item]), stored.as_pointer())


def load_at(builder: ir.IRBuilder, address: ir.Value, dtype: types.Float) -> ir.Value:
    """Load from `address`, aligned like single numbers."""
    value = builder.load(address)
    value.align = dtype.bitwidth // 8
    return value


def as_index(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    """Widen a non-negative number to the size of an address."""
    return number if number.type.width == 64 else builder.zext(number, INDEX)


def zeros(vector: Vector) -> ir.Value:
    """Return a vector of zeros."""
    return ir.Constant(llvm(vector), [0.0] * vector.width)


def _broadcast(
    context: BaseContext, builder: ir.IRBuilder, kind: types.Type, value: ir.Value, vector: Vector
) -> ir.Value:
    """Broadcast `value` to all lanes if it is a number."""
    if isinstance(kind, Vector):
        return value
    number = context.cast(builder, value, kind, vector.dtype)
    empty = ir.Constant(llvm(vector), ir.Undefined)
    one = builder.insert_element(empty, number, ir.IntType(32)(0))
    first = ir.Constant(ir.VectorType(ir.IntType(32), vector.width), [0] * vector.width)
    return builder.shuffle_vector(one, empty, first)


def _define_arithmetic(symbol: Callable[..., object], name: str) -> None:
    """Register one operator between vectors, and between vectors and numbers."""

    @infer_global(symbol)
    class Typing(AbstractTemplate):
        def generic(self, args: tuple[types.Type, ...], kws: object) -> Signature | None:
            vectors = [a for a in args if isinstance(a, Vector)]
            known = all(isinstance(a, Vector | types.Number) for a in args)
            if len(args) == 2 and vectors and known and len(set(vectors)) == 1:
                return signature(vectors[0], *args)
            return None

    def lower(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, args: Sequence[ir.Value]
    ) -> ir.Value:
        pairs = zip(sig.args, args, strict=True)
        a, b = (_broadcast(context, builder, kind, v, sig.return_type) for kind, v in pairs)
        return getattr(builder, name)(a, b, flags=FUSED)

    for kinds in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
        lower_builtin(symbol, *kinds)(lower)


_define_arithmetic(operator.add, "fadd")
_define_arithmetic(operator.sub, "fsub")
_define_arithmetic(operator.mul, "fmul")
_define_arithmetic(operator.truediv, "fdiv")


@intrinsic
def zero(typing: Context, x: types.Array) -> Intrinsic:
    """Return zero in each lane, in the precision of the array `x`."""
    vector = Vector(x.dtype, LANES)
    return vector(x), lambda context, builder, signature, arguments: zeros(vector)


@intrinsic
def load(typing: Context, x: types.Array, k: types.Integer) -> Intrinsic:
    """Return the lanes of row `k` of `x`, a contiguous array seen as (rows, LANES)."""
    vector = Vector(x.dtype, LANES)

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        first = builder.mul(as_index(builder, arguments[1]), INDEX(LANES))
        at = place(context, builder, x, arguments[0], first, llvm(vector))
        return load_at(builder, at, x.dtype)

    return vector(x, k), generate


@intrinsic
def store(typing: Context, x: types.Array, k: types.Integer, value: Vector) -> Intrinsic:
    """Put `value` into row `k` of `x`; see `load`."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        first = builder.mul(as_index(builder, arguments[1]), INDEX(LANES))
        to = place(context, builder, x, arguments[0], first, llvm(value))
        builder.store(arguments[2], to).align = x.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(x, k, value), generate


@intrinsic
def lanes_of(typing: Context, value: types.Type) -> Intrinsic:
    """Return a number unchanged, and an array (LANES,) as a `Vector`."""
    if not isinstance(value, types.Array):
        return value(value), lambda context, builder, signature, arguments: arguments[0]
    vector = Vector(value.dtype, LANES)

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        at = place(context, builder, value, arguments[0], INDEX(0), llvm(vector))
        return load_at(builder, at, value.dtype)

    return vector(value), generate


@intrinsic
def where_below(
    typing: Context, a: Vector, bound: types.Type, yes: types.Type, no: types.Type
) -> Intrinsic:
    """Return `yes` in the lanes where a < bound, else `no`; each is a vector or a number."""

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        kinds = (a, bound, yes, no)
        a_, bound_, yes_, no_ = (
            _broadcast(context, builder, kind, value, a)
            for kind, value in zip(kinds, arguments, strict=True)
        )
        return builder.select(builder.fcmp_ordered("<", a_, bound_), yes_, no_)

    return a(a, bound, yes, no), generate


@intrinsic
def rough_inverse_cube_root(typing: Context, a: Vector) -> Intrinsic:
    """Return ``a**(-1/3)`` within 4 %, for a > 0 in single precision's range.

    Dividing the bit pattern by three divides the exponent (Lomont 2003 divides by two).
    """

    def generate(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, arguments: Sequence[ir.Value]
    ) -> ir.Value:
        single = ir.VectorType(ir.FloatType(), a.width)
        whole = ir.VectorType(ir.IntType(32), a.width)
        bits = builder.bitcast(builder.fptrunc(arguments[0], single), whole)
        third = builder.sdiv(bits, ir.Constant(whole, [3] * a.width))
        rough = builder.sub(ir.Constant(whole, [0x54A2FA8C] * a.width), third)
        return builder.fpext(builder.bitcast(rough, single), llvm(a))

    return a(a), generate


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
        operand = place(context, builder, rows, rows_, first, stored)
        edge = load_at(builder, operand, types.float32)
        if total.dtype != types.float32:
            edge = builder.fpext(edge, wide)
        first = builder.mul(as_index(builder, j_), INDEX(4))
        four = llvm(Vector(total.dtype, 4))
        operand = load_at(builder, place(context, builder, x, x_, first, four), total.dtype)
        thrice = ir.Constant(ir.VectorType(ir.IntType(32), EDGE), [0, 1, 2, 3] * 3)
        operand = builder.shuffle_vector(operand, ir.Constant(four, ir.Undefined), thrice)
        return builder.fadd(total_, builder.fmul(edge, operand, flags=FUSED), flags=FUSED)

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
        address = place(context, builder, rows, arguments[0], first, ir.FloatType())
        builder.call(prefetch, [builder.bitcast(address, byte), number(1), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(rows, q), generate
