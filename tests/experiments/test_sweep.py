"""The runs of a study over devices: each once, one at a time a device, and again only what is left."""

from threading import Barrier, Lock

import pytest

NAMES = ["a_0", "b_0", "a_1", "b_1"]


@pytest.fixture
def sweep(scripts):
    return scripts("sweep")


def finish(out, name):
    (out / name).mkdir(exist_ok=True)
    (out / name / "study.json").write_text("[]")


def test_two_devices_work_at_a_time_and_never_two_runs_on_one(sweep, tmp_path):
    both, lock, busy, taken = Barrier(2, timeout=10), Lock(), set(), []

    def start(name, device):
        with lock:
            assert device not in busy
            busy.add(device)
            taken.append(name)
        both.wait()  # Passes only when the other device works too.
        with lock:
            busy.remove(device)
        finish(tmp_path, name)
        return 0

    assert sweep.sweep(NAMES, tmp_path, ["0", "1"], start) == []
    assert sorted(taken) == sorted(NAMES)


def test_called_again_it_does_what_is_left_and_names_what_failed(sweep, tmp_path):
    finish(tmp_path, "b_0")
    started = []

    def start(name, device):
        started.append(name)
        return 1 if name == "a_1" else 0

    assert sweep.sweep(NAMES, tmp_path, ["0"], start) == ["a_1"]
    assert started == ["a_0", "a_1", "b_1"]


def test_runs_have_the_names_that_a_study_gives_them(sweep):
    names = sweep.compare.run_names(sweep.compare.load_study("growth").variants, 2)
    assert len(names) == len(set(names)) and {name[-2:] for name in names} == {"_0", "_1"}


@pytest.mark.parametrize(("chosen", "expected"), [("0,2", ["0", "2"]), ("", ["cpu"])])
def test_devices_are_those_that_the_user_left_visible(sweep, monkeypatch, chosen, expected):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", chosen)
    assert sweep.visible_devices() == expected
