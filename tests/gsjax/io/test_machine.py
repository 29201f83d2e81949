"""What a machine has room for."""

import threading

import pytest

from gsjax.errors import InputError
from gsjax.io import machine

MEMINFO = "MemTotal: 9 kB\nMemAvailable:       3 kB\n"


@pytest.mark.parametrize(
    ("space", "data", "free"), [("4000", "9000", 2976), ("9000", "3000", 952), ("unlimited", "unlimited", 3072)]
)
def test_limits_of_the_process_itself_count(monkeypatch, space, data, free):
    texts = {
        "/proc/meminfo": MEMINFO,
        "/proc/self/status": "Name:\tpython\nVmSize:\t       1 kB\nVmData:\t       2 kB\n",
        "/proc/self/limits": f"Max data size  {data}  unlimited  bytes\nMax address space  {space}  9  bytes\n",
    }
    monkeypatch.setattr(machine, "_text", lambda path: texts.get(str(path), ""))
    assert machine.free_memory() == free


def test_threads_that_ask_for_memory_together_do_not_get_it_twice(monkeypatch):
    monkeypatch.setattr(machine, "free_memory", lambda: 100)
    order = []

    def work():
        with machine.memory_for("b", 60):
            order.append("b begins")

    thread = threading.Thread(target=work)
    with machine.memory_for("a", 60):
        thread.start()
        with machine.memory_for("c", 40):  # For which there is room beside the first.
            order.append("c")
        thread.join(0.2)
        order.append("a is done")
    thread.join(10)
    assert order == ["c", "a is done", "b begins"]
    with pytest.raises(InputError, match="d takes"), machine.memory_for("d", 101):
        pass


def test_groups_around_the_process_count_and_cached_files_are_free(monkeypatch):
    texts = {
        "/proc/meminfo": MEMINFO,
        "/proc/self/cgroup": "5:devices:/\n4:memory:/mine/job\n0::/mine/job\n",
        "/sys/fs/cgroup/memory.max": "2900",
        "/sys/fs/cgroup/memory.current": "100",
        "/sys/fs/cgroup/mine/memory.max": "2000",
        "/sys/fs/cgroup/mine/memory.current": "1500",
        "/sys/fs/cgroup/mine/memory.stat": "cache 9\ninactive_file 700\nactive_file 3\n",
    }
    monkeypatch.setattr(machine, "_text", lambda path: texts.get(str(path), ""))
    assert machine.free_memory() == 1200
