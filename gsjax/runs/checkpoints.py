"""A pytree of arrays as one uncompressed npz file, exact to the bit.

Each leaf is stored under its path in the tree (`.gaussians.means`, `.opt_state[0].mu.quats`), so a checkpoint opens
with plain numpy and says what it holds.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.errors import InputError
from gsjax.io.arrays import read_arrays
from gsjax.io.files import atomic_path


def save(path: str | Path, tree: Any) -> None:
    """Writes every leaf of `tree`: arrays of numbers or booleans, raw uint32 random keys, numpy or Python scalars.

    The path ends in `.npz`. `None` and static fields are structure and are not stored.
    """
    leaves = {name: np.asarray(leaf) for name, leaf in _named_leaves(tree)}
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, **leaves)


def load(path: str | Path, template: Callable[[dict[str, np.ndarray]], Any]) -> Any:
    """The tree of a template's structure with the stored leaves: numpy where it has numpy, else on jax's device.

    The template is made of the stored arrays by their paths; only its structure, shapes and dtypes are read.

    Raises:
        InputError: The file is absent, truncated or damaged, or its first difference from the template.
    """
    stored = load_arrays(path)
    like = template(stored)
    leaves_by_name = _named_leaves(like)
    surplus = stored.keys() - {name for name, _ in leaves_by_name}
    if surplus:
        raise InputError(f"{path}: holds {_quoted(min(surplus))}, which this run has no place for")
    leaves = [_checked(path, name, stored, leaf) for name, leaf in leaves_by_name]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """All stored arrays by their path in the tree; InputError of an absent, truncated or damaged file."""
    if not Path(path).is_file():
        raise InputError(f"{path}: no such checkpoint")
    try:
        return read_arrays(Path(path))
    except InputError as error:
        raise InputError(f"{path}: truncated or damaged checkpoint ({str(error).removeprefix(f'{path}: ')})") from error


def _named_leaves(tree: Any) -> list[tuple[str, Any]]:
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]]


def _checked(path: str | Path, name: str, stored: dict[str, np.ndarray], template: Any) -> Any:
    """The stored leaf `name`, if it is what `template` describes."""
    if name not in stored:
        raise InputError(f"{path}: {_quoted(name)} is missing")
    leaf, like = stored[name], template if hasattr(template, "dtype") else np.asarray(template)
    if (leaf.shape, leaf.dtype) != (tuple(like.shape), np.dtype(like.dtype)):
        expected = f"{np.dtype(like.dtype)}{list(like.shape)}"
        raise InputError(f"{path}: {_quoted(name)} is {leaf.dtype}{list(leaf.shape)}, expected {expected}")
    return leaf if isinstance(template, np.ndarray | np.generic) else jnp.asarray(leaf)


def _quoted(name: str) -> str:
    return f"'{name.lstrip('.')}'"
