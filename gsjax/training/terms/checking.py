"""Terms of the loss are tried on shapes alone before a run begins: a fault is one line that names its term."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from gsjax import rendering
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.rendering import View
from gsjax.rendering.depth import DepthReading
from gsjax.scene import batches
from gsjax.scene.batches import Batch
from gsjax.scene.cameras import Camera
from gsjax.training.terms import NEEDS, LossTerm, Term
from gsjax.training.terms.multi_view import render_neighbor

DATA_NEEDS = tuple(word for word in NEEDS if word != "gaussians")  # which are always at hand
ROWS, BANDS, PAIRS, SIZE = 4096, 15, 4096, (64, 64)  # of what terms are tried on; sizes of runs come from their photos

TermInputs = tuple[Gaussians, View, Batch]
"""What a term reads; shapes and dtypes only."""


def as_terms(
    terms: Mapping[str, Term | Callable[..., Array]], shapes: Callable[[int, int], TermInputs]
) -> dict[str, Term]:
    """The same with a `Term` for every bare function: it needs what it cannot be computed without.

    `shapes` is (width, height) -> all that a term may read, such as `shapes_of_training`.

    Raises:
        InputError: One of them is no function.
    """
    return {name: term if isinstance(term, Term) else _as_term(name, term, shapes) for name, term in terms.items()}


def _as_term(name: str, loss: Any, shapes: Callable[[int, int], TermInputs]) -> Term:
    if not callable(loss):
        raise InputError(f"terms.{name} is {loss!r}, expected a function of (Gaussians, View, Batch) or a Term of one")
    missing = _missing(loss, shapes(*SIZE), ())
    # Where it fails with everything, `check_term` says so, on photos of the run's size.
    return Term(loss, {"gaussians", *(missing or ())})


def check_term(each: LossTerm, everything: TermInputs) -> None:
    """Try a term with what it needs, and with nothing else of what its steps may show.

    Raises:
        InputError: It cannot be computed or differentiated, or its value is not one float.
    """
    loss, needs = each.term.loss, frozenset(each.term.needs)
    own = _with(everything, needs)
    error = _error(loss, own)
    if error is not None:
        missing = _missing(loss, everything, needs)
        if missing:
            read, declaration = (", ".join(words) for words in (map(NEEDS.__getitem__, missing), map(repr, missing)))
            raise _refusal(each, f"reads {read}, and does not declare it: needs={{{declaration}}}") from error
        raise _refusal(each, f"cannot be computed: {_in_words(error)}") from error
    value = jax.eval_shape(loss, *own)
    if not isinstance(value, jax.ShapeDtypeStruct):
        raise _refusal(each, f"returns {type(value).__name__}, expected one number")
    if value.shape:
        raise _refusal(each, f"returns an array of shape {value.shape}, expected one number, such as its mean")
    if not jnp.issubdtype(value.dtype, jnp.floating):
        raise _refusal(each, f"returns {value.dtype}, expected a float")
    try:
        jax.eval_shape(jax.grad(loss, argnums=(0, 1), allow_int=True), *own)
    except Exception as error:
        raise _refusal(each, f"cannot be differentiated: {_in_words(error)}") from error


def _refusal(each: LossTerm, fault: str) -> InputError:
    return InputError(f"the loss term '{each.name}' {fault}")


def _in_words(error: Exception) -> str:
    """The first line of an error: those of jax have pages."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _missing(loss: Callable[..., Any], everything: TermInputs, needs: Iterable[str]) -> tuple[str, ...] | None:
    """What a term lacks in its needs; None where it cannot be computed with everything."""
    own = frozenset(needs)
    if _error(loss, _with(everything, own)) is None:
        return ()
    missing = [word for word in DATA_NEEDS if word not in own]
    if _error(loss, everything) is not None:
        return None
    for word in tuple(missing):
        fewer = [other for other in missing if other != word]
        if _error(loss, _with(everything, own.union(fewer))) is None:
            missing = fewer
    return tuple(missing)


def _error(loss: Callable[..., Any], arguments: TermInputs) -> Exception | None:
    """Why a term cannot be computed; None: it can. What a user's function raises may be anything."""
    try:
        jax.eval_shape(loss, *arguments)
    except Exception as error:
        return error
    return None


def _with(everything: TermInputs, needs: frozenset[str]) -> TermInputs:
    """What a step shows a term that has these needs."""
    gaussians, view, batch = everything
    of_data = {"normals": "normals", "depth": "measured", "trust": "measured", "sky": "sky", "matte": "matte"}
    of_view = {"depth": "depth", "raw_depth": "depth", "axes": "axes", "neighbor": "neighbor", "mesh": "mesh"}
    view = view._replace(**dict.fromkeys(name for name, need in of_view.items() if need not in needs))
    batch = replace(batch, **dict.fromkeys(name for name, need in of_data.items() if need not in needs))
    return gaussians, view, batch


def shape(*sides: int, dtype: Any = jnp.float32) -> Any:
    """An array without values."""
    return jax.ShapeDtypeStruct(sides, dtype)


GAUSSIANS = Gaussians(
    shape(ROWS, 3), shape(ROWS, 4), shape(ROWS, 3), shape(ROWS), shape(ROWS, 1, 3), shape(ROWS, BANDS, 3)
)


def shapes_of_step(
    gaussians: Any, render: Callable[[Any, Batch, Array], View], width: int, height: int, **maps: Any
) -> TermInputs:
    """What a term reads in a step that renders Gaussians so, (Gaussians, decoded photo, colour behind them) -> view.

    `maps` are the fields of `Batch` in addition to photo and matte.
    """

    def rendered(gaussians: Any, target: Batch, color: Array) -> tuple[View, Batch]:
        batch = batches.decode(target, color)
        return render(gaussians, batch, color), batch

    target = Batch(
        Camera(shape(4, 4), shape(3, 3), width, height),
        image=shape(height, width, 3, dtype=jnp.uint8),
        valid=shape(height, width, dtype=bool),
        matte=shape(height, width, dtype=jnp.uint8),
        size=shape(2, dtype=jnp.int32),
        **maps,
    )
    return gaussians, *jax.eval_shape(rendered, gaussians, target, shape(3))


@lru_cache(maxsize=8)
def shapes_of_training(width: int, height: int, depth_mode: DepthReading = "plane") -> TermInputs:
    """All that any term of a training may read, as shapes."""
    how = {"capacity": PAIRS, "with_depth": True, "depth_mode": depth_mode, "with_axes": True}

    def render(gaussians: Gaussians, batch: Batch, color: Array) -> View:
        view = rendering.render(gaussians, batch.camera, background=color, **how)
        return view._replace(neighbor=render_neighbor(gaussians, batch, PAIRS, depth_mode))

    normals, trust = shape(height, width, 3, dtype=jnp.int8), shape(height, width, dtype=jnp.uint8)
    maps = {"normals": normals, "depth": shape(height, width), "trust": trust, "photo": shape(dtype=jnp.int32)}
    return shapes_of_step(GAUSSIANS, render, width, height, sky=shape(height, width, dtype=bool), **maps)
