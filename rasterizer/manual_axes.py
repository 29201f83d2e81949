"""The mesh axes that arrays vary over inside `jax.shard_map`. Outside of it there are none, and nothing is changed.

`shard_map` checks by default that both branches of a condition, the carries of a loop and the arguments of a foreign
call vary over the same axes. A constant varies over none, so it is marked where it meets an argument. An engine is
traced as if there were no axes: it has no collectives, and many loops.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

T = TypeVar("T")


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

    Args:
        function: Of arrays to a pytree of arrays, without collectives. Not differentiated.
        arguments: Pytrees of arrays.
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
