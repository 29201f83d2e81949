"""Vectors of float32 for the loops over pixels, with Python's operators: LLVM holds each in registers.

A float32 number in an expression with vectors stands for a vector of equal lanes. The vectors are explicit because LLVM
finds none in short loops, which it unrolls into scalars.
"""

import operator
from collections.abc import Callable
from itertools import product
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.registry import cpu_target as _cpu_target
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

cpu_target: Any = _cpu_target  # Its types know nothing of its context.
# A register of AVX-512 holds sixteen numbers, one of AVX2 eight, two of NEON eight. numba names what it compiles for.
LANES = 16 if "+avx512f" in cpu_target.target_context.codegen().magic_tuple()[2] else 8
INT, FLOAT = ir.IntType(32), ir.FloatType()
INTS, EIGHT = ir.VectorType(INT, LANES), ir.VectorType(FLOAT, 8)


class Vector(types.Type):
    """`LANES` numbers of a kind."""

    def __init__(self, name: str, lane: ir.Type) -> None:
        super().__init__(name)
        self.vector = ir.VectorType(lane, LANES)


@extending.register_model(Vector)
class _VectorModel(extending.models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, kind.vector)


FLOATS, MASK = Vector(f"float32x{LANES}", FLOAT), Vector(f"boolx{LANES}", ir.IntType(1))
POINTER = types.CPointer(types.float32)


def _as_vector(builder, number):
    """The vector of equal lanes of a number; anything else as it is."""
    if number.type != FLOAT:
        return number
    undefined = ir.Constant(FLOATS.vector, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(INT, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(INTS, [0] * LANES))


def _compiles_to(result: types.Type, *kinds: types.Type, key: Any = None) -> Callable[[Callable], Any]:
    """Registers a function that emits instructions: compiled code calls it, or `key`, without the builder.

    Args:
        result: What compiled code receives.
        kinds: Its arguments. A number may stand for any of the vectors, but not for all.
        key: The operator that is given this meaning; None for the function itself.
    """

    def register(emit: Callable) -> Any:
        function = key or emit
        combinations = list(product(*((kind, types.float32) if kind is FLOATS else (kind,) for kind in kinds)))
        allowed = [each for each in combinations if each == kinds or set(each) != {types.float32}]

        class Template(AbstractTemplate):
            key = function

            def generic(self, args, kws):
                return signature(result, *args) if tuple(args) in allowed else None

        def lower(context, builder, signature, arguments):
            emitted = emit(builder, *(_as_vector(builder, x) for x in arguments))
            return context.get_dummy_value() if result is types.void else emitted

        infer_global(function, types.Function(Template))
        for each in allowed:
            extending.lower_builtin(function, *each)(lower)
        return emit

    return register


def _arithmetic(name: str) -> Callable:
    # A product and a sum may round once.
    return lambda builder, a, b: getattr(builder, name)(a, b, flags=("contract",))


def _comparison(symbol: str) -> Callable:
    return lambda builder, a, b: builder.fcmp_ordered(symbol, a, b)


for _key, _name in {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}.items():
    _compiles_to(FLOATS, FLOATS, FLOATS, key=_key)(_arithmetic(_name))
_COMPARISONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq}
for _symbol, _key in _COMPARISONS.items():
    _compiles_to(MASK, FLOATS, FLOATS, key=_key)(_comparison(_symbol))
_compiles_to(FLOATS, FLOATS, key=operator.neg)(lambda builder, a: builder.fneg(a))
_compiles_to(MASK, MASK, MASK, key=operator.and_)(lambda builder, a, b: builder.and_(a, b))
_compiles_to(MASK, MASK, MASK, key=operator.or_)(lambda builder, a, b: builder.or_(a, b))


@_compiles_to(FLOATS, types.float32)
def broadcast(builder, number):
    """Return the vector of equal lanes."""
    return number


@_compiles_to(FLOATS, POINTER)
def load(builder, pointer):
    """Return the vector at a place."""
    return builder.load(builder.bitcast(pointer, FLOATS.vector.as_pointer()), align=4)


@_compiles_to(types.void, POINTER, FLOATS)
def store(builder, pointer, value):
    """Write a vector at a place."""
    builder.store(value, builder.bitcast(pointer, FLOATS.vector.as_pointer()), align=4)


@_compiles_to(FLOATS, MASK, FLOATS, FLOATS)
def where(builder, mask, one, other):
    """Return each lane of the one where the mask holds, else of the other."""
    return builder.select(mask, one, other)


def _choice(symbol: str, *flags: str) -> Any:
    def choose(builder, one, other):
        return builder.select(builder.fcmp_ordered(symbol, one, other, flags=flags), one, other, flags=flags)

    return _compiles_to(FLOATS, FLOATS, FLOATS)(choose)


# The smaller or larger of two numbers, neither of which is NaN where the result is used. Without this promise LLVM
# makes a masked store of a store of the result, with which a forward pass takes 1.3 to 1.7 times as long under AVX2.
minimum, maximum = (_choice(symbol, "nnan", "nsz") for symbol in "<>")
smaller, larger = map(_choice, "<>")  # The same, and the second where either is NaN.


def _function(name: str) -> Any:
    kind = ir.FunctionType(FLOATS.vector, [FLOATS.vector])

    def emit(builder, value):
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32"), [value])

    return _compiles_to(FLOATS, FLOATS)(emit)


floor, absolute, square_root = map(_function, ("floor", "fabs", "sqrt"))


@_compiles_to(FLOATS, FLOATS, FLOATS)
def limit_bits(builder, value, limit):
    """Return what lies in 0..limit as it is; a positive limit for all else: what is larger, negative or NaN."""
    # Read as unsigned integers, the bits of negative numbers and of NaN are above those of positive numbers.
    a, b = builder.bitcast(value, INTS), builder.bitcast(limit, INTS)
    return builder.bitcast(builder.select(builder.icmp_unsigned("<", a, b), a, b), FLOATS.vector)


@_compiles_to(FLOATS, FLOATS, FLOATS)
def times_power_of_two(builder, value, exponent):
    """Return value * 2^exponent for whole exponents that keep a normal number normal."""
    shifted = builder.shl(builder.fptosi(exponent, INTS), ir.Constant(INTS, [23] * LANES))
    return builder.bitcast(builder.add(builder.bitcast(value, INTS), shifted), FLOATS.vector)


@_compiles_to(types.boolean, MASK)
def any_lane(builder, mask):
    """Whether a mask holds anywhere."""
    bits = ir.IntType(LANES)
    return builder.icmp_unsigned("!=", builder.bitcast(mask, bits), ir.Constant(bits, 0))


def _shuffled(builder, one, other, lanes):
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(INT, len(lanes)), lanes))


def _add_halves(builder, value):
    """The vector of half as many lanes: the sum of a vector's halves."""
    half = value.type.count // 2
    parts = [_shuffled(builder, value, value, list(range(start, start + half))) for start in (0, half)]
    return builder.fadd(*parts)


def _add_neighbours(builder, one, other):
    """Sums of neighbours of two vectors of eight lanes, where an instruction for four lanes leaves them."""
    first = [quarter + lane for quarter in (0, 4) for lane in (0, 2, 8, 10)]
    return builder.fadd(
        _shuffled(builder, one, other, first), _shuffled(builder, one, other, [lane + 1 for lane in first])
    )


@_compiles_to(types.void, POINTER, types.UniTuple(FLOATS, 8))
def add_eight_sums(builder, target, values):
    """Add the sums of the lanes of eight vectors to eight numbers at a place: one tree for all of them."""
    values = cgutils.unpack_tuple(builder, values, 8)
    while values[0].type.count > 8:
        values = [_add_halves(builder, value) for value in values]
    while len(values) > 2:
        values = [_add_neighbours(builder, values[n], values[n + 1]) for n in range(0, len(values), 2)]
    lower = _shuffled(builder, values[0], values[1], [0, 1, 2, 3, 8, 9, 10, 11])
    upper = _shuffled(builder, values[0], values[1], [4, 5, 6, 7, 12, 13, 14, 15])
    place = builder.bitcast(target, EIGHT.as_pointer())
    builder.store(builder.fadd(builder.load(place, align=4), builder.fadd(lower, upper)), place, align=4)


@_compiles_to(types.float32, FLOATS)
def sum_of_lanes(builder, value):
    """Return the sum of a vector's lanes, as a tree."""
    while value.type.count > 2:
        value = _add_halves(builder, value)
    return builder.fadd(*(builder.extract_element(value, ir.Constant(INT, lane)) for lane in (0, 1)))
