"""Reverse mode of first order alone: what a backward pass written by hand has, and one line for who asks for more."""

from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

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
