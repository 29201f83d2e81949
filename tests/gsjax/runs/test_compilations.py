import jax
import pytest

from gsjax import pipeline
from gsjax.errors import InputError
from gsjax.runs import compilations
from gsjax.settings import Settings


def test_a_run_begins_with_room_for_its_programs(monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(jax, "clear_caches", lambda: calls.append("cleared"))
    for most, expected in ((10**9, []), (0, ["cleared"])):
        monkeypatch.setattr(compilations, "MOST_MAPPINGS", most)
        with pytest.raises(InputError):
            pipeline.train(tmp_path, tmp_path / "out", Settings())
        assert calls == expected
