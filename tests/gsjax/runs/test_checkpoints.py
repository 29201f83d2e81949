from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from gsjax.errors import InputError
from gsjax.runs import checkpoints


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    params: dict
    opt_state: optax.OptState
    key: jax.Array
    step: jax.Array
    mask: np.ndarray


def make_state():
    bits = np.array([0.0, -0.0, 1e-45, 1e38, np.inf, -np.inf, np.nan], np.float32)
    params = {"means": jnp.asarray(bits), "empty": jnp.zeros((0, 3), jnp.float32)}
    return State(
        params=params,
        opt_state=optax.chain(optax.adam(1e-3), optax.trace(0.9)).init(params),
        key=jax.random.PRNGKey(7),
        step=jnp.int32(41),
        mask=np.array([True, False]),
    )


def raw_bytes(tree):
    return [(np.asarray(x).tobytes(), np.asarray(x).dtype, np.shape(x)) for x in jax.tree.leaves(tree)]


def test_round_trip_keeps_every_bit_and_the_structure(tmp_path):
    state = make_state()
    checkpoints.save(tmp_path / "state.npz", state)
    loaded = checkpoints.load(tmp_path / "state.npz", lambda _: state)
    assert jax.tree.structure(loaded) == jax.tree.structure(state)
    assert raw_bytes(loaded) == raw_bytes(state)
    assert isinstance(loaded.key, jax.Array) and isinstance(loaded.mask, np.ndarray)


@pytest.mark.parametrize(
    ("like", "message"),
    [
        ({"a": np.zeros(3, np.float32), "b": np.zeros(2, np.int32)}, r"x.npz: '\['b'\]' is missing"),
        ({}, r"x.npz: holds '\['a'\]', which this run has no place for"),
        ({"a": np.zeros(4, np.float32)}, r"x.npz: '\['a'\]' is float32\[3\], expected float32\[4\]"),
        ({"a": np.zeros(3, np.int32)}, r"x.npz: '\['a'\]' is float32\[3\], expected int32\[3\]"),
    ],
)
def test_the_first_difference_is_named(tmp_path, like, message):
    checkpoints.save(tmp_path / "x.npz", {"a": np.ones(3, np.float32)})
    with pytest.raises(InputError, match=message):
        checkpoints.load(tmp_path / "x.npz", lambda _: like)


def test_truncated_and_absent_files_are_one_line(tmp_path):
    path = tmp_path / "state.npz"
    checkpoints.save(path, {"a": np.arange(1000, dtype=np.float32)})
    whole = path.read_bytes()
    for share in (0.0, 0.5, 0.99):
        path.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(InputError, match=r"^[^\n]*state\.npz: truncated or damaged checkpoint[^\n]*$"):
            checkpoints.load_arrays(path)
    with pytest.raises(InputError, match="no such checkpoint"):
        checkpoints.load_arrays(tmp_path / "absent.npz")
