"""How often the step of a growing run is compiled."""

from jax import monitoring
from small_scenes import camera_at, cloud, photographed

from gsjax.settings import Density, Model, Phase, Rates, Schedule, Settings, Weights
from gsjax.training import buffers
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.loop import fit
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import initial_state

BUDGET, EXTENT, STEPS = 1024, 1.0, 40


def test_a_step_compiles_at_most_three_times_while_gaussians_grow_to_four_times_the_fewest_rows(monkeypatch):
    """Once for each length of the buffers, which double; views that need longer lists compile nothing."""
    monkeypatch.setattr(buffers, "FEWEST_ROWS", BUDGET // 4)
    programs, lengths = [], []

    def listen(event, seconds, **about):
        if event.endswith("backend_compile_duration"):
            programs.append(str(about.get("fun_name")))

    phase = Phase("vanilla", STEPS, Weights(dssim=0.0), density_control=True)
    settings = Settings(
        seed=8,
        model=Model(max_gaussians=BUDGET),
        schedule=Schedule(phases=(phase,)),
        density=Density(rule="error", start=1, stop=STEPS, every=4, full_by=0.9),
    )
    optimizer = make_optimizer(Rates(), EXTENT, STEPS)
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    state = initial_state(cloud(200, capacity=BUDGET // 4), optimizer, DENSIFICATION_RULES["error"])
    frames = photographed(cloud(50, seed=5), cameras)
    monitoring.register_event_duration_secs_listener(listen)
    try:
        fit(
            settings,
            frames,
            EXTENT,
            state,
            optimizer,
            observe=lambda progress: lengths.append(progress.state.gaussians.num_gaussians),
        )
    finally:
        monitoring.unregister_event_duration_listener(listen)
    assert sorted(set(lengths)) == [BUDGET // 4, BUDGET // 2, BUDGET], "the run grows through all lengths"
    assert 1 <= sum("train_step" in each for each in programs) <= 3
