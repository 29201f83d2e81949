"""Light and its display code, sRGB (IEC 61966-2-1): numpy in, numpy out, and likewise JAX."""

from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import Array

AnyArray = TypeVar("AnyArray", np.ndarray, Array)


def srgb_to_linear(encoded: AnyArray) -> AnyArray:
    """Light of sRGB values, both 0..1, any shape."""
    return _where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: AnyArray) -> AnyArray:
    """The sRGB values of light, both 0..1, any shape; differentiable at 0 too."""
    is_dark = linear <= 0.0031308
    return _where(is_dark, 12.92 * linear, 1.055 * _where(is_dark, 1.0, linear) ** (1 / 2.4) - 0.055)


def _where(condition: Any, yes: Any, no: Any) -> Any:
    return (np if isinstance(condition, np.ndarray | np.bool_) else jnp).where(condition, yes, no)
