"""One short run for all files here: a process trains it once."""

from pathlib import Path

import jax
import pytest
from small_scenes import built_in
from trained_run import FEW_POINTS, MASK, SETTINGS

from gsjax import config, pipeline, runs
from gsjax.io.images import write_image
from gsjax.runs import compilations
from gsjax.training import step


@pytest.fixture(scope="module", autouse=True)
def _every_program_is_kept():
    """The same few programs run again and again here, in both workers: the session's store takes the smallest too."""
    least = jax.config.jax_persistent_cache_min_compile_time_secs
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    yield
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least)


@pytest.fixture(scope="session")
def scene(tmp_path_factory) -> Path:
    folder = built_in(tmp_path_factory.mktemp("data") / "scene", num_views=9, size=(48, 40))
    write_image(folder / "masks/003.png", MASK)
    return folder


@pytest.fixture(scope="session")
def run(scene, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "whole"
    steps = []

    def observe(progress):
        newest = runs.latest_checkpoint(folder)
        assert newest is None or newest[0] < progress.step, "told before the checkpoint is written"
        steps.append(progress.step)

    step._shared_train_step.cache_clear()  # the run compiles, whatever tests came before
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(compilations, "_SHORTEST", 0.0)  # one that the session's store answers counts as well
        summary = pipeline.train(scene, folder, SETTINGS, observe=observe)
    assert steps == list(range(1, 31))
    assert summary["steps"] == 30
    assert summary["views"] == 2
    return folder


@pytest.fixture(scope="session")
def first_phase(scene, tmp_path_factory) -> tuple[Path, dict]:
    """The first phase of that run alone, and its settings."""
    phases = SETTINGS["schedule"]["phases"][:1]
    settings = config.merge(SETTINGS, {"schedule": {"phases": phases}, "rates": {"decay_steps": 30}})
    folder = tmp_path_factory.mktemp("runs") / "first"
    pipeline.train(scene, folder, settings)
    return folder, settings


@pytest.fixture(scope="session")
def run_mesh(run, tmp_path_factory) -> tuple[Path, dict]:
    """The mesh of the run and its report, from few points."""
    file = tmp_path_factory.mktemp("mesh") / "mesh.ply"
    return file, pipeline.mesh(run, file, **FEW_POINTS)


@pytest.fixture(scope="session")
def run_scores(run, run_mesh) -> dict:
    """The scores of the run with that mesh."""
    return pipeline.evaluate(run, mesh=run_mesh[0])
