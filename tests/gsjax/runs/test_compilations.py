import jax
import jax.numpy as jnp
import pytest

from gsjax import pipeline
from gsjax.errors import InputError
from gsjax.runs import compilations
from gsjax.runs.compilations import Compilations
from gsjax.settings import Settings


def test_programs_are_named_once_each_and_only_while_one_listens(monkeypatch):
    monkeypatch.setattr(compilations, "_SHORTEST", 0.0)
    values = jnp.arange(7.0)
    with Compilations() as listener:

        @jax.jit
        def halved(x):
            return 0.5 * x

        for _ in range(2):
            halved(values)
        assert [one["program"] for one in listener.drain()].count("halved") == 1
        assert listener.drain() == []
    jax.jit(lambda x: x - 3)(values)
    assert listener.drain() == []


def test_a_run_begins_with_room_for_its_programs(monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(jax, "clear_caches", lambda: calls.append("cleared"))
    for most, expected in ((10**9, []), (0, ["cleared"])):
        monkeypatch.setattr(compilations, "MOST_MAPPINGS", most)
        with pytest.raises(InputError):
            pipeline.train(tmp_path, tmp_path / "out", Settings())
        assert calls == expected
