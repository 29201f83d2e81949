"""Vectors of float32 for the loops over pixels, with Python's operators: LLVM holds each in a processor's register.

A number in an expression with vectors stands for a vector of equal lanes. LLVM's own search for vectors fails on short
loops, which it unrolls into scalars.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

from rasterizer._native.instructions import intrinsic

LANES = 8
CONTRACT = ("contract",)  # a product and a sum may round once


NUMBERS = ("nnan", "nsz")


class Vector(types.Type):
    """LANES numbers of float32, or of one bit."""

    def __init__(self, name: str, lane: ir.Type) -> None:
        super().__init__(name)
        self.vector = ir.VectorType(lane, LANES)


@extending.register_model(Vector)
class _VectorModel(extending.models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, kind.vector)


INT = ir.IntType(32)
FLOATS, MASK = Vector("floats", ir.FloatType()), Vector("mask", ir.IntType(1))
INTS = ir.VectorType(INT, LANES)


def _broadcast(builder, number):
    """The vector of a number; a vector as it is."""
    if isinstance(number.type, ir.VectorType):
        return number
    kind = ir.VectorType(number.type, LANES)
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), number, ir.Constant(INT, 0))
    return builder.shuffle_vector(first, ir.Constant(kind, ir.Undefined), ir.Constant(INTS, [0] * LANES))


def _define_operator(function, result: Vector, operand: types.Type, emit) -> None:
    """Gives one of Python's operators its meaning for two vectors, and for a vector and a number."""

    class Template(AbstractTemplate):
        key = function

        def generic(self, args, kws):
            if len(args) == 2 and operand in args and all(x in (operand, types.float32) for x in args):
                return signature(result, *args)
            return None

    infer_global(function)(Template)

    def lower(context, builder, sig, args):
        return emit(builder, *(_broadcast(builder, x) for x in args))

    for pair in ((operand, operand), (operand, types.float32), (types.float32, operand)):
        extending.lower_builtin(function, *pair)(lower)


def _arithmetic(name):
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=CONTRACT)


def _comparison(symbol):
    return lambda builder, a, b: builder.fcmp_ordered(symbol, a, b)


for _function, _name in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")):
    _define_operator(_function, FLOATS, FLOATS, _arithmetic(_name))
for _function, _symbol in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "==")):
    _define_operator(_function, MASK, FLOATS, _comparison(_symbol))
_define_operator(operator.and_, MASK, MASK, lambda builder, a, b: builder.and_(a, b))
_define_operator(operator.or_, MASK, MASK, lambda builder, a, b: builder.or_(a, b))


@intrinsic
def broadcast(typingctx, number):
    """The vector of equal lanes."""

    def codegen(context, builder, signature, arguments):
        return _broadcast(builder, arguments[0])

    return FLOATS(types.float32), codegen


@intrinsic
def load(typingctx, pointer):
    """The vector at a place."""

    def codegen(context, builder, signature, arguments):
        return builder.load(builder.bitcast(arguments[0], FLOATS.vector.as_pointer()), align=4)

    return FLOATS(pointer), codegen


@intrinsic
def store(typingctx, pointer, value):
    """Writes a vector at a place."""

    def codegen(context, builder, signature, arguments):
        place = builder.bitcast(arguments[0], FLOATS.vector.as_pointer())
        builder.store(_broadcast(builder, arguments[1]), place, align=4)
        return context.get_dummy_value()

    return types.void(pointer, value), codegen


@intrinsic
def where(typingctx, mask, yes, no):
    """Lane by lane, one of two."""

    def codegen(context, builder, signature, arguments):
        mask, yes, no = arguments
        return builder.select(mask, _broadcast(builder, yes), _broadcast(builder, no))

    return FLOATS(MASK, yes, no), codegen


def _extreme(symbol):
    @intrinsic
    def extreme(typingctx, one, other):
        def codegen(context, builder, signature, arguments):
            a, b = (_broadcast(builder, x) for x in arguments)
            # As numbers, which no vector here fails to be: or a store of the result becomes one under a mask, which
            # takes many times as long on some processors.
            return builder.select(builder.fcmp_ordered(symbol, a, b, flags=NUMBERS), a, b, flags=NUMBERS)

        return FLOATS(one, other), codegen

    return extreme


smaller, larger = _extreme("<"), _extreme(">")


def _unary(name):
    @intrinsic
    def unary(typingctx, value):
        def codegen(context, builder, signature, arguments):
            kind = FLOATS.vector
            name_of_kind = f"llvm.{name}.v{LANES}f32"
            function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), name_of_kind)
            return builder.call(function, arguments)

        return FLOATS(FLOATS), codegen

    return unary


@infer_global(operator.neg)
class _Negative(AbstractTemplate):
    def generic(self, args, kws):
        return signature(FLOATS, FLOATS) if args == (FLOATS,) else None


@extending.lower_builtin(operator.neg, FLOATS)
def _lower_negative(context, builder, sig, args):
    return builder.fneg(args[0])


floor, magnitude = _unary("floor"), _unary("fabs")


@intrinsic
def clamp_bits(typingctx, value, limit):
    """The value where it lies between 0 and a positive limit, else the limit: for negative numbers and NaN, too."""

    def codegen(context, builder, signature, arguments):
        # The bits of what is negative or no number are, as unsigned numbers, above those of the limit.
        a, b = (builder.bitcast(_broadcast(builder, x), INTS) for x in arguments)
        return builder.bitcast(builder.select(builder.icmp_unsigned("<", a, b), a, b), FLOATS.vector)

    return FLOATS(FLOATS, types.float32), codegen


@intrinsic
def scale_by_power(typingctx, value, whole):
    """value * 2^whole, of a whole number that leaves it normal."""

    def codegen(context, builder, signature, arguments):
        value, whole = arguments
        exponent = builder.shl(builder.fptosi(whole, INTS), ir.Constant(INTS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(value, INTS), exponent), FLOATS.vector)

    return FLOATS(FLOATS, FLOATS), codegen


@intrinsic
def any_of(typingctx, mask):
    """Whether the mask holds anywhere."""

    def codegen(context, builder, signature, arguments):
        bits = builder.bitcast(arguments[0], ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(MASK), codegen


def _halves(builder, value):
    count = value.type.count // 2
    undefined = ir.Constant(value.type, ir.Undefined)
    return [
        builder.shuffle_vector(value, undefined, ir.Constant(ir.VectorType(INT, count), list(range(a, a + count))))
        for a in (0, count)
    ]


def _add_pair(builder, a, b):
    """Sums of neighbours: those of `a`, then those of `b`, within each four lanes as a processor's shuffle has them."""
    lanes = a.type.count
    undefined = ir.VectorType(INT, lanes)
    base = [4 * q for q in range(lanes // 4)]
    even = [x for q in base for x in (q, q + 2, lanes + q, lanes + q + 2)]
    odd = [x for q in base for x in (q + 1, q + 3, lanes + q + 1, lanes + q + 3)]
    return builder.fadd(
        builder.shuffle_vector(a, b, ir.Constant(undefined, even)),
        builder.shuffle_vector(a, b, ir.Constant(undefined, odd)),
    )


def _sum_eight(builder, vectors):
    """The vector of the sums of eight vectors of eight lanes, as a tree."""
    pairs = [_add_pair(builder, a, b) for a, b in zip(vectors[::2], vectors[1::2], strict=True)]
    fours = [_add_pair(builder, a, b) for a, b in zip(pairs[::2], pairs[1::2], strict=True)]
    eight = ir.VectorType(INT, 8)
    low = builder.shuffle_vector(*fours, ir.Constant(eight, [0, 1, 2, 3, 8, 9, 10, 11]))
    high = builder.shuffle_vector(*fours, ir.Constant(eight, [4, 5, 6, 7, 12, 13, 14, 15]))
    return builder.fadd(low, high)


@intrinsic
def add_eight_sums(typingctx, target, vectors):
    """target[i] += the sum of the lanes of vectors[i], for a tuple of eight."""

    def codegen(context, builder, signature, arguments):
        values = cgutils.unpack_tuple(builder, arguments[1], 8)
        while values[0].type.count > 8:
            values = [builder.fadd(*_halves(builder, x)) for x in values]
        sums = _sum_eight(builder, values)
        place = builder.bitcast(arguments[0], sums.type.as_pointer())
        builder.store(builder.fadd(builder.load(place, align=4), sums), place, align=4)
        return context.get_dummy_value()

    return types.void(target, vectors), codegen


@intrinsic
def sum_of_lanes(typingctx, value):
    """The sum of the lanes, as a tree."""

    def codegen(context, builder, signature, arguments):
        value = arguments[0]
        while value.type.count > 1:
            if value.type.count == 2:
                return builder.fadd(*(builder.extract_element(value, ir.Constant(INT, i)) for i in range(2)))
            value = builder.fadd(*_halves(builder, value))
        return value

    return types.float32(FLOATS), codegen
