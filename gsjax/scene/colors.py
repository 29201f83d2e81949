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


def shares(colors: np.ndarray) -> np.ndarray:
    """float32 shares of 1 of colours that are shares, or count to 255 or to 65,535; numpy, any shape."""
    most = np.nanmax(colors, initial=0)
    return np.asarray(colors, np.float32) / np.float32(1 if most <= 1 else 255 if most <= 255 else 65535)


def to_bytes(shares: np.ndarray | Array) -> np.ndarray:
    """uint8 values of shares of 1, cut to 0..1, and grey of those that are no number; any shape."""
    values = np.asarray(shares)
    return np.rint(255 * np.where(np.isnan(values), 0.5, np.clip(values, 0, 1))).astype(np.uint8)


def _where(condition: Any, yes: Any, no: Any) -> Any:
    return (np if isinstance(condition, np.ndarray | np.bool_) else jnp).where(condition, yes, no)
