"""Short vectors for compiled loops: several numbers added and multiplied in one instruction.

The loop over a row of the tangent is too short, and writes too close to its reads, for
the compiler to vectorise; assembly is one long sequence for each element. A `Vector`
explicitly processes `LANES` items at once: right-hand sides in `sparse_products`,
elements in `assembly`. It adds, subtracts, multiplies and divides with vectors and
numbers. LLVM splits widths that a processor lacks (512, 256 bits). A `Vector` exists
only inside a compiled function, in registers.
"""

import operator
from collections.abc import Callable, Sequence

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
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
