"""The shapes that the annotations of public names state, checked by jaxtyping and beartype: in tests alone."""

from collections import Counter
from dataclasses import replace
from inspect import isfunction
from typing import get_args, get_type_hints

import jax
import pytest
from beartype import beartype
from beartype.roar import BeartypeDoorHintViolation
from jaxtyping import TypeCheckError, jaxtyped
from public_calls import CALLS, make_arrays
from record_fields import check_fields

import gsjax
import rasterizer
from rasterizer import Moments, Projection, TilePairs

EACH_CALL = pytest.mark.parametrize(("name", "names", "options"), CALLS, ids=[name for name, *_ in CALLS])


@pytest.fixture(scope="module")
def arrays():
    return make_arrays()


def checked(name):
    return jaxtyped(public(name), typechecker=beartype)


def public(name):
    return getattr(rasterizer, name, None) or getattr(gsjax, name)


def arguments_of(arrays, names):
    return {name: arrays[source or name] for name, _, source in (item.partition(":") for item in names.split())}


def dimensions(hint):
    """Those of every array that an annotation accepts."""
    return [part.dim_str.split() for part in get_args(hint) or (hint,) if hasattr(part, "dim_str")]


@EACH_CALL
def test_a_call_takes_and_returns_the_stated_shapes_under_jit(arrays, name, names, options):
    def call(arguments):
        result = checked(name)(**arguments, **options)
        for record in result if type(result) is tuple else [result]:
            if isinstance(record, Projection | TilePairs | Moments | gsjax.View | gsjax.Gaussians):
                check_fields(record)
        return result

    arguments = arguments_of(arrays, names)
    call(arguments) if name == "from_points" else jax.eval_shape(jax.jit(call), arguments)


@EACH_CALL
def test_twice_the_columns_are_refused_where_a_number_or_another_argument_says_so(arrays, name, names, options):
    arguments, hints = arguments_of(arrays, names), get_type_hints(public(name))
    stated = {key: dimensions(hints[key]) for key in arguments}
    uses = Counter(dim for shapes in stated.values() for dim in {dim for shape in shapes for dim in shape})
    for key, shapes in stated.items():
        last = {shape[-1] for shape in shapes if shape} - {"..."}
        if last and all(dim.isdigit() or "{" in dim or uses[dim] > 1 for dim in last):
            with pytest.raises(TypeCheckError):
                checked(name)(**{**arguments, key: arguments[key].repeat(2, -1)}, **options)


def test_a_field_of_another_shape_is_found(arrays):
    check_fields(gsjax.init(arrays["gaussians"], gsjax.adam(1.0, steps=5)))
    for wrong in ({"quats": arrays["means"]}, {"means": arrays["means"][1:]}):
        with pytest.raises(BeartypeDoorHintViolation):
            check_fields(replace(arrays["gaussians"], **wrong))


def test_every_function_with_annotated_shapes_is_called():
    functions = {name: public(name) for name in rasterizer.__all__ + gsjax.__all__ if isfunction(public(name))}
    annotated = {name for name, each in functions.items() if any(map(dimensions, get_type_hints(each).values()))}
    assert annotated - {"align_normals"} == {name for name, *_ in CALLS}
