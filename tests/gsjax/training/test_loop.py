from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring
from small_scenes import camera_at, cloud, fit, photographed

from gsjax.errors import InputError
from gsjax.gaussians import opacities, take
from gsjax.settings import Density, Model, Phase, Rates, Schedule, Settings, Weights
from gsjax.training import buffers, loop
from gsjax.training.densification import gradient_driven
from gsjax.training.densification.gradient_driven import is_alive
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import count_alive, initial_state

PLAIN = Weights(dssim=0.0)
EXTENT, ALIVE, CAPACITY = 1.0, 30, 48
SETTINGS = Settings(
    seed=3,
    model=Model(background="random", max_gaussians=CAPACITY),
    schedule=Schedule(
        phases=(
            Phase("coarse", 6, PLAIN, image_scale=2, density_control=True, cull_below=0.6),
            Phase("surface", 5, Weights(dssim=0.0, entropy=0.1, sdf_normal=0.2)),
        ),
        sh_every=4,
    ),
    density=Density(start=1, stop=6, every=2, reset_every=5),
)
OPTIMIZER = make_optimizer(Rates(), EXTENT, 11)


def start():
    return initial_state(cloud(ALIVE, capacity=CAPACITY, seed=1), OPTIMIZER)


@pytest.fixture(scope="module", autouse=True)
def high_reset():
    """Opacities are reset to what leaves some of these few steps' Gaussians above the cull."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gradient_driven, "RESET_OPACITY", 0.7)
        yield


@pytest.fixture(scope="module")
def frames():
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    return photographed(cloud(50, seed=5), cameras, with_mattes=True)


class Watch:
    """Copies of what the loop reports, and of the Gaussians that normals are read for."""

    def __init__(self):
        self.progress, self.states, self.requests = [], [], []

    def observe(self, progress):
        # The next step takes the state's buffers: a checkpoint copies.
        self.states.append(jax.tree.map(np.array, progress.state))
        self.progress.append(progress._replace(state=None))

    def read_normals(self, state):
        self.requests.append(jax.tree.map(np.array, state.gaussians))
        return [np.tile(np.int8([12, 25, -124]), (24, 32, 1))] * 3


def fitted(frames, settings=SETTINGS, state=None, capacity=None):
    watch = Watch()
    state = start() if state is None else jax.tree.map(jnp.asarray, state)
    watching = {"normal_source": watch.read_normals, "observe": watch.observe}
    final = fit(settings, frames, EXTENT, state, OPTIMIZER, **watching, capacity=capacity)
    return SimpleNamespace(final=final, **watch.__dict__)


@pytest.fixture(scope="module")
def whole(frames):
    """The uninterrupted run."""
    return fitted(frames)


def assert_identical(actual, expected):
    jax.tree.map(np.testing.assert_array_equal, actual, expected)


def test_phases_follow_each_other_with_their_terms_and_the_prior_is_asked_for_normals_once(whole):
    steps = [(p.step, p.phase.name, p.phase_done) for p in whole.progress]
    names = ["coarse"] * 6 + ["surface"] * 5
    assert steps == [(i + 1, name, i + 1 in (6, 11)) for i, name in enumerate(names)]
    assert [int(s.step) for s in whole.states] == list(range(1, 12))
    terms = {p.phase.name: set(p.metrics.terms) for p in whole.progress}
    assert terms == {"coarse": {"l1", "alpha"}, "surface": {"l1", "alpha", "entropy", "sdf_normal"}}
    assert len({(p.phase.name, p.capacity) for p in whole.progress}) == 2  # a capacity is a compilation
    assert_identical(whole.states[-1], whole.final)
    (gaussians,) = whole.requests
    assert_identical(gaussians, whole.states[5].gaussians)


def test_gaussians_grow_and_are_reset_only_when_due_and_culled_at_the_end_of_the_phase(whole):
    alive = [int(count_alive(s.gaussians)) for s in whole.states]
    assert alive[0] == ALIVE  # not before `start`
    assert alive[1] > ALIVE and alive[2] == alive[1] and alive[3] >= alive[2]  # at steps 2 and 4, not at 3
    assert alive[4] == alive[3] <= CAPACITY
    opacity = [np.asarray(opacities(s.gaussians)) for s in whole.states]
    assert opacity[3].max() > 0.75
    assert opacity[4].max() == pytest.approx(0.7, abs=1e-5)
    assert alive[5] == (opacity[5] >= 0.6).sum() < alive[4]
    assert alive[6:] == [alive[5]] * 5


def test_after_a_cull_a_run_goes_on_in_shorter_buffers_to_the_same_bits(whole, frames, monkeypatch):
    monkeypatch.setattr(buffers, "_fitting", lambda count, most: count)
    short = fitted(frames)
    alive = int(count_alive(whole.final.gaussians))
    assert [state.gaussians.num_gaussians for state in short.states] == [CAPACITY] * 5 + [alive] * 6
    assert_identical(short.final.gaussians, take(whole.final.gaussians, np.asarray(is_alive(whole.final.gaussians))))


@pytest.mark.parametrize("done", [3, 6])
def test_a_run_continued_from_a_copy_ends_with_the_same_bits(frames, whole, done):
    """From the middle of the first phase, in a buffer that is too short, and from its end."""
    capacity = 64 if done == 3 else whole.progress[done].capacity
    resumed = fitted(frames, state=whole.states[done - 1], capacity=capacity)
    assert [p.step for p in resumed.progress] == list(range(done + 1, 12))
    assert resumed.progress[0].capacity > 64 and len(resumed.requests) == 1
    for again, before in zip(resumed.states, whole.states[done:], strict=True):
        assert_identical(again, before)
    assert_identical(resumed.final, whole.final)


@pytest.mark.parametrize("first_step", [0, 3])
def test_terms_of_the_surface_may_come_every_third_step_on_smaller_photos_and_the_others_always(
    frames, monkeypatch, first_step
):
    calls = []

    def make_train_step(optimizer, terms, **_):
        def step(state, target, key):
            calls.append((int(state.step), {each.name for each in terms}, target.image.shape[:2]))
            return replace(state, step=state.step + 1), SimpleNamespace(overflowed=False, finite=True, needed=1)

        return step

    monkeypatch.setattr(loop, "kept_step", make_train_step)
    weights = Weights(dssim=0.0, entropy=0.1, sdf_normal=0.2, depth_normal=0.3)
    settings = SETTINGS.replace(schedule={"phases": (Phase("surface", 7, weights, surface_every=3, surface_scale=2),)})
    fitted(frames, settings, state=replace(start(), step=np.int32(first_step)), capacity=64)
    always = {"l1", "alpha", "entropy"}, (24, 32)
    rarely = always[0] | {"sdf_normal", "depth_normal"}, (12, 16)
    every = [always, always, rarely, always, always, rarely, always]
    assert calls == [(step, *each) for step, each in enumerate(every)][first_step:]


@pytest.mark.parametrize(
    ("message", "raised", "line"),
    [
        ("RESOURCE_EXHAUSTED: Out of memory", InputError, r"^[^\n]* no room for a step at 32x24 [^\n]*$"),
        ("INTERNAL: something else", jax.errors.JaxRuntimeError, "something else"),
    ],
)
def test_a_device_without_room_is_one_line_and_any_other_failure_stays_one(frames, monkeypatch, message, raised, line):
    def make_train_step(optimizer, terms, **_):
        def step(state, target, key):
            raise jax.errors.JaxRuntimeError(message)

        return step

    monkeypatch.setattr(loop, "kept_step", make_train_step)
    with pytest.raises(raised, match=line):
        fitted(frames, SETTINGS.replace(schedule={"phases": (Phase("plain", 1, PLAIN),)}), capacity=64)


def test_error_driven_densification_fills_the_budget_and_resumes_to_the_same_bits(frames):
    """With Gaussians left out of every step, which a resumed run leaves out as well."""
    density = Density(rule="error", start=0, stop=6, every=2, full_by=0.5)
    settings = SETTINGS.replace(
        density=density, schedule={"phases": (replace(SETTINGS.schedule.phases[0], cull_below=0.0),), "dropout": 0.3}
    )

    def start():
        return initial_state(cloud(ALIVE, capacity=CAPACITY, seed=1), OPTIMIZER, DENSIFICATION_RULES["error"])

    run = fitted(frames, settings, start())
    assert [int(count_alive(s.gaussians)) for s in run.states] == [ALIVE, *[CAPACITY] * 5]
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(SETTINGS.seed), 0), 3)
    stays = np.asarray(jax.random.uniform(key, (CAPACITY,), jnp.float32) >= 0.3)[:ALIVE]
    moved = np.any(run.states[0].gaussians.means != np.asarray(start().gaussians.means), axis=1)[:ALIVE]
    views = run.states[0].statistics.views[:ALIVE]
    assert not moved[~stays].any() and not views[~stays].any(), "a step learns of those that it draws alone"
    assert moved[stays].mean() > 0.5
    for before, after in zip(run.states[2:4], run.states[3:5], strict=True):
        moved = np.abs(after.gaussians.means - before.gaussians.means).max(1) > 0.02  # A step is under 2e-4.
        assert moved.any() == (int(after.step) == 4), "a full budget goes on moving"
    resumed = fitted(frames, settings, run.states[2], capacity=run.progress[2].capacity)
    assert_identical(resumed.final, run.final)


def test_a_step_compiles_at_most_three_times_while_gaussians_grow_to_four_times_the_rows(frames, monkeypatch):
    """Once for each length of the buffers, which double; views that need longer lists compile nothing."""
    monkeypatch.setattr(buffers, "FEWEST_ROWS", CAPACITY // 4)
    programs = []

    def listen(event, seconds, **about):
        if event.endswith("backend_compile_duration") and "train_step" in str(about.get("fun_name")):
            programs.append(about)

    density = Density(rule="error", start=1, stop=12, every=2, full_by=0.9)
    phase = Phase("vanilla", 12, Weights(dssim=0.0, alpha=0.1), density_control=True)
    state = initial_state(cloud(10, capacity=CAPACITY // 4), OPTIMIZER, DENSIFICATION_RULES["error"])
    monitoring.register_event_duration_secs_listener(listen)
    try:
        run = fitted(frames, SETTINGS.replace(density=density, schedule={"phases": (phase,)}), state)
    finally:
        monitoring.unregister_event_duration_listener(listen)
    rows = {state.gaussians.num_gaussians for state in run.states}
    assert rows == {CAPACITY // 4, CAPACITY // 2, CAPACITY}, "the run grows through all lengths"
    assert 1 <= len(programs) <= 3
