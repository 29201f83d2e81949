"""Terms that are handed in: bare functions, and what is wrong with one, told before the first step."""

from functools import partial

import jax
import jax.numpy as jnp
import pytest

from gsjax.errors import InputError
from gsjax.training.terms import NEEDS, TERMS, LossTerm, Term
from gsjax.training.terms.checking import as_terms, check_term, shapes_of_training


def check(term, width=48, height=40):
    (term,) = as_terms({"mine": term}, shapes_of_training).values()
    check_term(LossTerm("mine", 0.1, term), shapes_of_training(width, height))
    return frozenset(term.needs)


READS = {
    "depth": lambda g, v, b: jnp.mean(v.depth),
    "normals": lambda g, v, b: jnp.mean(b.normals * v.colors),
    "measured": lambda g, v, b: jnp.mean(b.trust * b.depth * v.alphas),
    "neighbor": lambda g, v, b: jnp.mean(v.neighbor.depth),
}


@pytest.mark.parametrize("need", READS)
def test_what_a_bare_function_needs_is_found_and_what_a_term_does_not_declare_is_named(need):
    assert check(READS[need]) == {need, "gaussians"}
    assert check(Term(READS[need], {need})) == {need}
    with pytest.raises(InputError) as refused:
        check(Term(READS[need], {"gaussians"}))
    assert str(refused.value) == (
        f"the loss term 'mine' reads {NEEDS[need]}, and does not declare it: needs={{{need!r}}}"
    )


def test_of_several_needs_the_missing_ones_are_named_and_no_others():
    def both(gaussians, view, batch):
        return jnp.mean(view.depth[..., None] * batch.normals * view.axes) + jnp.mean(gaussians.log_scales)

    assert check(both) == {"depth", "normals", "axes", "gaussians"}
    with pytest.raises(InputError, match=r"needs=\{'axes', 'normals'\}$"):
        check(Term(both, {"depth"}))


def test_what_is_read_only_where_it_is_there_is_no_need():
    def either(gaussians, view, batch):
        return jnp.mean(view.alphas if view.depth is None else view.depth)

    assert check(either) == {"gaussians"}


@pytest.mark.parametrize(
    "callable_",
    [
        jax.jit(lambda g, v, b: jnp.mean(jax.vmap(jnp.sum)(g.means)) + jnp.mean(v.colors)),
        partial(lambda weight, g, v, b: weight * jnp.mean(v.colors), 2.0),
        lambda g, v, b: jnp.mean(v.colors).astype(jnp.bfloat16),
        lambda *args: jnp.mean(jnp.abs(args[1].colors - args[2].image) * jnp.zeros((40, 48, 1))),  # of this very size
        TERMS["multi_view"].loss,
    ],
)
def test_any_function_of_the_three_that_returns_one_float_will_do(callable_):
    check(callable_)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda g, v, b: v.colors, r"returns an array of shape \(40, 48, 3\), expected one number"),
        (lambda g, v, b: jnp.sum(b.valid), "returns int32, expected a float"),
        (lambda g, v, b: jnp.mean(v.colours), "cannot be computed: AttributeError: .*'colours'"),
        (lambda g, v: jnp.mean(v.colors), "cannot be computed: TypeError: .*positional arguments"),
        (lambda g, v, b: float(jnp.mean(v.colors)), "cannot be computed: ConcretizationTypeError"),
        (
            lambda g, v, b: jax.lax.while_loop(lambda x: x < 1, lambda x: x + jnp.mean(v.alphas), jnp.mean(v.colors)),
            "cannot be differentiated: ValueError: Reverse-mode differentiation",
        ),
    ],
)
def test_what_is_wrong_with_a_term_is_one_line_that_names_it(wrong, message):
    with pytest.raises(InputError, match=f"^the loss term 'mine' {message}") as refused:
        check(wrong)
    assert str(refused.value).isprintable()
