"""Checkpoints of a training that does not wait for them."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from gsjax import runs
from gsjax.errors import InputError
from gsjax.runs import journal


@pytest.fixture
def on_a_gpu(monkeypatch):
    """Journals take the device for one whose arrays the host gets as copies."""
    monkeypatch.setattr(journal, "computes_on_cpu", lambda: False)


def state_of(value):
    gaussians = SimpleNamespace(num_gaussians=2)
    return type("State", (dict,), {"gaussians": gaussians})(means=np.full(2, value, np.float32))


def test_steps_go_on_while_a_checkpoint_awaits_its_write_and_the_end_waits_for_it(on_a_gpu, monkeypatch, tmp_path):
    """The first write waits for an event that is set after `save` returns; the context ends with both on disk."""
    may_write, on_disk = threading.Event(), []

    def slow(run, step, tree):
        assert may_write.wait(60)
        on_disk.append((step, float(tree["capacity"])))

    monkeypatch.setattr(runs, "save_checkpoint", slow)
    with journal.Journal(tmp_path, "train", 10, 0, 0.0) as log:
        log.save(5, state_of(1.0), 7)
        assert not on_disk
        may_write.set()
        log.save(10, state_of(2.0), 8)
    assert on_disk == [(5, 7.0), (10, 8.0)]


@pytest.mark.parametrize("saves", [1, 2])
def test_a_checkpoint_that_cannot_be_on_disk_ends_the_run_in_its_line(on_a_gpu, monkeypatch, tmp_path, saves):
    """At the next checkpoint or at the end, whichever comes first."""

    def full(run, step, tree):
        raise InputError(f"step {step}: the disk is full")

    monkeypatch.setattr(runs, "save_checkpoint", full)
    with (
        pytest.raises(InputError, match="step 1: the disk is full"),
        journal.Journal(tmp_path, "train", 10, 0, 0.0) as log,
    ):
        for step in range(1, saves + 1):
            log.save(step, state_of(1.0), 0)
