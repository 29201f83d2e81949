"""Leading dimensions: many scenes, each with its cameras, in one call. A function of one scene is mapped over them."""

import inspect
from collections.abc import Callable
from functools import wraps
from math import prod
from typing import Any, ParamSpec, TypeVar

import jax

P = ParamSpec("P")
R = TypeVar("R")
_SCENE_RANKS = {
    "means": 2,
    "quats": 2,
    "scales": 2,
    "opacities": 1,
    "viewmats": 3,
    "Ks": 3,
    "covars": 3,
    "radial_coeffs": 2,
    "backgrounds": 2,
    "masks": 3,
    "means2d_probe": 3,
    "absgrad": 3,
}  # Dimensions of one scene's array, by the name of the argument.


def maps_over_batches(render: Callable[P, R]) -> Callable[P, R]:
    """The function of one scene, as one of `[...]` scenes: those of the leading dimensions that `means` has.

    An array without them is the same for all scenes. Every array that comes back has them.

    Raises:
        ValueError: An array has other leading dimensions than `means`, or these hold no scene.
    """
    signature = inspect.signature(render)

    @wraps(render)
    def with_batches(*args: P.args, **kwargs: P.kwargs) -> R:
        given = signature.bind(*args, **kwargs)
        batch = given.arguments["means"].shape[:-2]
        if not batch:
            return render(*args, **kwargs)
        if not prod(batch):
            raise ValueError(f"means.shape={given.arguments['means'].shape} holds no scene")
        mapped = {
            name: array.reshape(-1, *array.shape[len(batch) :])
            for name, array in given.arguments.items()
            if name in {*_SCENE_RANKS, "colors"} and _has_batch(name, array, batch, given.arguments.get("sh_degree"))
        }

        def one(arrays: dict[str, jax.Array]) -> Any:
            of_one = signature.bind(*args, **kwargs)
            of_one.arguments.update(arrays)
            return render(*of_one.args, **of_one.kwargs)

        results = jax.vmap(one)(mapped)
        return jax.tree.map(lambda result: result.reshape(*batch, *result.shape[1:]), results)

    return with_batches


def _has_batch(name: str, array: jax.Array | None, batch: tuple[int, ...], sh_degree: int | None) -> bool:
    """Whether an argument has the leading dimensions; raises where it has others."""
    if array is None or isinstance(array, bool):
        return False
    if name == "colors":
        # Without harmonics they are of every Gaussian of a scene, or of every camera and Gaussian.
        ranks, is_shared = ((3,), array.ndim == 3) if sh_degree is not None else ((2, 3), array.ndim == 2)
    else:
        ranks = (_SCENE_RANKS[name],)
        is_shared = array.ndim in (ranks[0], 0)
    if is_shared:
        return False
    if array.ndim - len(batch) not in ranks or array.shape[: len(batch)] != batch:
        raise ValueError(f"{name}.shape={array.shape}, expected the leading dimensions of means, {batch}, or none")
    return True
