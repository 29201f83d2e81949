"""What a machine has room for."""

import pytest

from gsjax.errors import InputError
from gsjax.io import machine


def test_what_there_is_no_room_for_is_refused(monkeypatch):
    machine.require_memory("a page", 4096)
    with pytest.raises(InputError, match=r"^a\.spz: 9 Gaussians takes 9\.31e\+08 GiB of memory; [\d.]+ are free$"):
        machine.require_memory("a.spz: 9 Gaussians", 1e18)


@pytest.mark.parametrize(
    ("limit", "used", "free"), [("max", "5", 3072), ("", "", 3072), ("2000", "500", 1500), ("9000", "500", 3072)]
)
def test_a_containers_limit_counts(monkeypatch, limit, used, free):
    texts = {"meminfo": "MemTotal: 9 kB\nMemAvailable:       3 kB\n", "memory.max": limit, "memory.current": used}
    monkeypatch.setattr(machine, "_text", lambda path: texts[str(path).rpartition("/")[2]])
    assert machine.free_memory() == free
