"""The few instructions that numba has no word for: memory by address, one atomic addition, calls through pointers."""

import ctypes
import os
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import extending, types

WORD = ir.IntType(64)
intrinsic: Any = extending.intrinsic  # What it makes of a function takes one argument less: its types say otherwise.


def _pointer_to(kind: types.Type):
    @intrinsic
    def as_pointer(typingctx, address):
        def codegen(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.int64), codegen

    return as_pointer


as_int64s, as_int32s, as_bytes, as_floats = map(_pointer_to, (types.int64, types.int32, types.uint8, types.float32))


def _numbers_at(kind: types.Type):
    @intrinsic
    def numbers_at(typingctx, pointer, place):
        def codegen(context, builder, signature, arguments):
            return builder.gep(arguments[0], [arguments[1]])

        return types.CPointer(kind)(pointer, types.int64), codegen

    return numbers_at


floats_at, int32s_at = map(_numbers_at, (types.float32, types.int32))  # (pointer, place): the numbers from a place on


@intrinsic
def prefetch(typingctx, pointer):
    """Requests the numbers at a place ahead of their use. Any address is allowed."""

    def codegen(context, builder, signature, arguments):
        place = builder.bitcast(arguments[0], ir.IntType(8).as_pointer())
        kinds = [place.type, *[ir.IntType(32)] * 3]
        function = builder.module.declare_intrinsic(
            "llvm.prefetch", [place.type], ir.FunctionType(ir.VoidType(), kinds)
        )
        builder.call(function, [place, *(ir.Constant(ir.IntType(32), value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(pointer), codegen


def _room(builder, kind, count):
    with builder.goto_entry_block():
        room = builder.alloca(ir.ArrayType(kind, count.literal_value))
        room.align = 64
    return room


@intrinsic(prefer_literal=True)
def floats_on_stack(typingctx, count):
    """Room for `count` floats, a literal, until the function returns. LLVM knows that nothing else lies there."""

    def codegen(context, builder, signature, arguments):
        return builder.bitcast(_room(builder, ir.FloatType(), count), ir.FloatType().as_pointer())

    return types.CPointer(types.float32)(count), codegen


@intrinsic(prefer_literal=True)
def words_on_stack(typingctx, count):
    """Address of room for `count` words, a literal, until the function returns."""

    def codegen(context, builder, signature, arguments):
        return builder.ptrtoint(_room(builder, WORD, count), WORD)

    return types.int64(count), codegen


@intrinsic
def fetch_add(typingctx, address, value):
    """What the word at an address held, before `value` is added to it: by one thread at a time."""

    def codegen(context, builder, signature, arguments):
        place = builder.inttoptr(arguments[0], WORD.as_pointer())
        return builder.atomic_rmw("add", place, arguments[1], "seq_cst")

    return types.int64(types.int64, types.int64), codegen


@intrinsic
def call(typingctx, function, argument):
    """The word that a C function of one word returns, given the function's address."""

    def codegen(context, builder, signature, arguments):
        kind = ir.FunctionType(WORD, [WORD])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [arguments[1]])

    return types.int64(types.int64, types.int64), codegen


@intrinsic(prefer_literal=True)
def address_of(typingctx, name):
    """Address of what `define` gave a name, a literal."""

    def codegen(context, builder, signature, arguments):
        module = builder.module
        symbol = module.globals.get(name.literal_value)
        kind = ir.FunctionType(WORD, [WORD])
        return builder.ptrtoint(symbol or ir.Function(module, kind, name.literal_value), WORD)

    return types.int64(name), codegen


@intrinsic
def code_of(typingctx, loop, do):
    """Address of a C function of one word, which `loop(word, do)` answers. Both are compiled functions."""
    called = typingctx.resolve_function_type(loop, (types.int64, do), {})

    def codegen(context, builder, signature, arguments):
        compiled = loop.dispatcher.get_compile_result(called)
        context.add_linking_libs([compiled.library])
        function = ir.Function(builder.module, ir.FunctionType(WORD, [WORD]), f"task_{compiled.fndesc.mangled_name}")
        function.linkage = "internal"
        function.attributes.add("noinline")  # Or LLVM would copy its text to where this thread calls it, too.
        body = ir.IRBuilder(function.append_basic_block())
        context.call_internal_no_propagate(body, compiled.fndesc, called, [function.args[0], context.get_dummy_value()])
        body.ret(WORD(0))
        return builder.ptrtoint(function, WORD)

    return types.int64(loop, do), codegen


def define(name: str, address: int) -> None:
    """Gives an address of this process the name by which compiled code, of another process too, finds it."""
    llvm.add_symbol(name, address)


NO_MEMORY = ctypes.create_string_buffer(b"the rasterizer's loops found no memory for their workspace")


def _define_names() -> None:
    python = ctypes.pythonapi  # Their allocator needs no lock and is the same on every system.
    system = ctypes.WinDLL("kernel32").SwitchToThread if os.name == "nt" else ctypes.CDLL(None).sched_yield
    calls = {"allocate": python.PyMem_RawMalloc, "release": python.PyMem_RawFree, "give_way": system}
    for name, function in calls.items():
        define(f"rasterizer_{name}", ctypes.cast(function, ctypes.c_void_p).value or 0)
    define("rasterizer_no_memory", ctypes.addressof(NO_MEMORY))


_define_names()
