"""What may be passed for an array: JAX's and numpy's of any number type, numbers and lists of numbers; nothing else."""

import inspect
import reprlib
from collections.abc import Callable
from functools import wraps
from types import NoneType
from typing import Any, ParamSpec, TypeVar, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

P = ParamSpec("P")
R = TypeVar("R")
# Arguments that hold indices or truth values; the others become floats.
_NO_FLOATS = {"masks", "radii", "isect_ids", "isect_offsets", "flatten_ids", "visible"}


def takes_arrays(function: Callable[P, R]) -> Callable[P, R]:
    """The function, given an array for every argument annotated `Array` or `Float[Array, ...]`, or either and None.

    All become arrays of one dtype: float64 where the first of them is, else float32. A gradient has the dtype of the
    array that the caller passed.

    Raises:
        TypeError: An argument is something else, such as a tensor of torch, or None where an array must be.
    """
    signature = inspect.signature(function)
    kinds = {name: p.annotation for name, p in signature.parameters.items() if _is_array(p.annotation)}
    may_be_none = {name: NoneType in get_args(kind) for name, kind in kinds.items()}

    @wraps(function)
    def with_arrays(*args: P.args, **kwargs: P.kwargs) -> R:
        call = signature.bind(*args, **kwargs)
        passed = {name: value for name, value in call.arguments.items() if name in may_be_none}
        floats = (value for name, value in passed.items() if name not in _NO_FLOATS)
        first = next((value.dtype for value in floats if isinstance(value, jax.Array | np.ndarray)), float)
        dtype = np.float64 if jax.dtypes.canonicalize_dtype(first) == np.float64 else np.float32
        for name, value in passed.items():
            if value is not None or not may_be_none[name]:
                call.arguments[name] = _as_array(name, value, dtype)
        return function(*call.args, **call.kwargs)

    return with_arrays


def _is_array(annotation: Any) -> bool:
    kinds = [kind for kind in get_args(annotation) or (annotation,) if kind is not NoneType]
    return all(getattr(kind, "array_type", kind) is Array for kind in kinds)


def _as_array(name: str, value: Any, dtype: Any) -> Array:
    if isinstance(value, jax.Array | np.ndarray):
        return value if name in _NO_FLOATS else as_float(name, value, dtype)  # pyright: ignore[reportReturnType]
    if not isinstance(value, list | tuple | bool | int | float | np.generic):
        kind = f"{type(value).__module__}.{type(value).__qualname__}"
        raise TypeError(f"{name} is of type {kind}, expected an array of JAX or numpy, or a list of numbers")
    try:
        return np.asarray(value) if name in _NO_FLOATS else jnp.asarray(value, dtype)  # pyright: ignore[reportReturnType]
    except (TypeError, ValueError) as fault:
        raise TypeError(f"{name}={reprlib.repr(value)} is no array of numbers") from fault


def as_float(name: str, array: Any, dtype: Any) -> Any:
    """The array of real numbers in a float dtype; one that has it already is left as it is."""
    source_dtype = jax.dtypes.canonicalize_dtype(array.dtype)
    if source_dtype == dtype:
        return array
    if not (
        jnp.issubdtype(source_dtype, jnp.floating)
        or jnp.issubdtype(source_dtype, jnp.integer)
        or source_dtype == jnp.bool_
    ):
        raise TypeError(f"{name}.dtype={array.dtype}, expected real numbers")
    return jnp.asarray(array, dtype)


def in_float32(array: Any) -> Any:
    """The array as the tile engines compute with it; truth values stay what they are."""
    return array if array.dtype == np.bool_ else as_float("an array", array, np.float32)


def whole_number(name: str, value: Any, least: int) -> Any:
    """The static number as Python's, whatever kind of number it is; None is one not given.

    Raises:
        ValueError: It is traced, no whole number or under the least.
    """
    if value is None:
        return None
    if isinstance(value, Tracer):
        raise ValueError(f"{name} is traced, but static: pass a number, or mark it in static_argnames of your jit")
    if int(value) != value or value < least:
        raise ValueError(f"{name}={value}, expected a whole number of at least {least}")
    return int(value)
