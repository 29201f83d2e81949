"""How close is close: one table by dtype, and the assertion that reads it."""

import jax
import numpy as np

# dtype -> what is compared -> (rtol, atol). A gradient sums over many pixels and divides by small numbers.
TOLERANCES = {
    np.dtype("float32"): {"value": (1e-5, 1e-5), "gradient": (1e-3, 1e-4)},
    np.dtype("float64"): {"value": (1e-9, 1e-9), "gradient": (1e-7, 1e-8)},
}


def assert_close(actual, expected, *, kind="value", why=None, rtol=None, atol=None):
    """Asserts equal structure, shapes and, within the table's tolerance of `actual`'s dtype, numbers.

    `expected` may be of another dtype (a float64 oracle). NaNs are never equal. Another tolerance than the table's
    needs its reason in `why`; integers and booleans must be equal.
    """
    if (rtol is None and atol is None) != (why is None):
        raise ValueError("a tolerance of one's own and its reason go together")
    actual_leaves, actual_tree = jax.tree.flatten_with_path(actual)
    expected_leaves, expected_tree = jax.tree.flatten(expected)
    assert actual_tree == expected_tree, f"{actual_tree} is not {expected_tree}"
    for (path, leaf), expected_leaf in zip(actual_leaves, expected_leaves, strict=True):
        leaf, expected_leaf = np.asarray(leaf), np.asarray(expected_leaf)
        name = jax.tree_util.keystr(path) or "array"
        assert leaf.shape == expected_leaf.shape, f"{name}: shape {leaf.shape} is not {expected_leaf.shape}"
        default_rtol, default_atol = TOLERANCES[leaf.dtype][kind] if leaf.dtype in TOLERANCES else (0.0, 0.0)
        np.testing.assert_allclose(
            leaf,
            expected_leaf,
            rtol=default_rtol if rtol is None else rtol,
            atol=default_atol if atol is None else atol,
            equal_nan=False,
            err_msg=f"{name} ({why or kind})",
        )
