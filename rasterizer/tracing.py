"""Tracing beyond jnp: walls to fusion, derivatives of first order alone, and the mesh axes of `jax.shard_map`."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from rasterizer.devices import default_device

T = TypeVar("T")


def walled(function: Callable[..., T], is_wanted: Array, *inputs: Any) -> T:
    """The function's value behind a wall to XLA's fusion where that helps, on a CPU; zeros where it is not wanted.

    A branch is such a wall. Without it the stacking of components is fused into their computation, and the derivative
    takes ten times as long on a CPU. A GPU would wait for the host to take the branch.
    """
    if default_device().platform != "cpu":
        return function(*inputs)
    nothing = jax.eval_shape(function, *inputs)
    zeros = jax.tree.map(lambda part: vary_like(jnp.zeros(part.shape, part.dtype), inputs), nothing)
    return jax.lax.cond(is_wanted, function, lambda *_: zeros, *inputs)


# Reverse mode of first order. A backward pass written by hand has no other derivative.

_identity = Primitive("rasterizer_reverse_only")
_pushforward = Primitive("rasterizer_pushforward")


def reverse_only(x: Array) -> Array:
    """The array itself, which `jax.grad` and `jax.vjp` pass through once.

    Raises:
        TypeError: In forward mode (when the derivative is compiled or computed), or differentiated a second time.
    """
    return _identity.bind(x, differentiated=False)


def _refuse(*_args, **_params):
    raise TypeError(
        "forward-mode and second derivatives (jax.jvp, jax.jacfwd, jax.linearize, jax.hessian) need "
        "backend='reference': the tile backends have jax.grad and jax.vjp alone, once"
    )


def _jvp(primals, tangents, *, differentiated: bool):
    (x,), (tangent,) = primals, tangents
    if differentiated:
        _refuse()
    return _identity.bind(x, differentiated=True), tangent if type(tangent) is ad.Zero else _pushforward.bind(tangent)


_identity.def_impl(lambda x, **_: x)
_identity.def_abstract_eval(lambda x, **_: x)
batching.defvectorized(_identity)
mlir.register_lowering(_identity, lambda _, x, **__: [x])
ad.primitive_jvps[_identity] = _jvp

# Reverse mode transposes a tangent away before it is computed; whoever computes it is in forward mode.
_pushforward.def_impl(_refuse)
_pushforward.def_abstract_eval(lambda tangent: tangent)
batching.primitive_batchers[_pushforward] = _refuse
mlir.register_lowering(_pushforward, _refuse)
ad.deflinear2(_pushforward, lambda cotangent, _: [cotangent])


# Mesh axes. `shard_map` checks by default that both branches of a condition, the carries of a loop and the arguments of
# a foreign call vary over the same axes. A constant varies over none, so it is marked where it meets an argument. An
# engine is traced as if there were no axes: it has no collectives, and many loops.


def _axes(*trees: Any) -> set[str]:
    return set().union(*(jax.typeof(leaf).manual_axis_type.varying for leaf in jax.tree.leaves(trees)))


def vary_like(tree: T, *others: Any) -> T:
    """The same arrays, marked as varying over all axes that an array of the others varies over.

    The transpose of the mark is a sum over the devices.
    """
    axes = _axes(others)

    def marked(leaf: Array) -> Array:
        return jax.lax.pcast(leaf, tuple(sorted(axes - _axes(leaf))), to="varying")

    return jax.tree.map(marked, tree) if axes else tree


def vary_alike(tree: T) -> T:
    """The same arrays, marked as varying over all axes that any of them varies over."""
    return vary_like(tree, tree)


def without_axes(function: Callable[..., T], *arguments: Any) -> T:
    """The function's value, traced as if no argument varied over an axis; the results vary as the arguments do.

    It is without collectives, of pytrees of arrays to one, and not differentiated.
    """
    if not _axes(arguments):
        return function(*arguments)
    leaves, tree = jax.tree.flatten(vary_alike(arguments))
    plain = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
    results = jax.tree.structure(jax.eval_shape(function, *tree.unflatten(plain)))

    def flat(*leaves: Array) -> list[Array]:
        return jax.tree.leaves(function(*tree.unflatten(leaves)))

    return results.unflatten(_bind(flat, *leaves))


def result(shape: tuple[int, ...], dtype: Any) -> jax.ShapeDtypeStruct:
    """The description of a kernel's result that says, where `shard_map` asks, that it varies over no axis."""
    return jax.eval_shape(lambda: jnp.zeros(shape, dtype))


_plain_call = Primitive("rasterizer_without_axes")
_plain_call.multiple_results = True


def _bind(function: Callable[..., list[Array]], *arguments: Array) -> list[Array]:
    results = jax.eval_shape(function, *(jax.ShapeDtypeStruct(each.shape, each.dtype) for each in arguments))
    marked = jax.make_jaxpr(lambda: [vary_like(jnp.zeros(each.shape, each.dtype), arguments) for each in results])()
    return _plain_call.bind(*arguments, function=function, results=tuple(marked.out_avals))


def _lower(ctx, *arguments, function, **_):
    plain = [ShapedArray(aval.shape, aval.dtype) for aval in ctx.avals_in]
    return mlir.lower_fun(function, multiple_results=True)(ctx.replace(avals_in=plain), *arguments)


def _batch(arguments, axes, *, function, **_):
    results = _bind(jax.vmap(function, in_axes=axes), *arguments)
    return results, [0] * len(results)


_plain_call.def_impl(lambda *arguments, function, **_: function(*arguments))
_plain_call.def_abstract_eval(lambda *_, results, **__: list(results))
batching.primitive_batchers[_plain_call] = _batch
mlir.register_lowering(_plain_call, _lower)
