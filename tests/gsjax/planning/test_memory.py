import numpy as np
import pytest

from gsjax.io.temporary_files import ArraysOnDisk
from gsjax.planning import memory
from gsjax.planning.memory import fit_to_memory, photo_bytes
from gsjax.scene import Frame
from gsjax.settings import Model, Phase, Schedule, Settings, Weights
from gsjax.training.plan import plan

EYE = np.eye(4, dtype=np.float32)
PIXELS, MASKED = 1000 * 800, 2
FRAMES = [
    Frame(f"{i}.jpg", EYE, EYE[:3, :3], 1000, 800, lambda: pytest.fail("planning needs no pixels"), masked=i < MASKED)
    for i in range(100)
]
PLAN = plan(
    Settings(
        schedule=Schedule(phases=(Phase("coarse", 10, image_scale=2), Phase("surface", 10, Weights(sdf_normal=0.1)))),
        model=Model(max_gaussians=1_000_000),
    )
)
PHOTOS, NORMALS = 3 * 100 * PIXELS + MASKED * PIXELS, 3 * 100 * PIXELS
GAUSSIANS = memory.A_ROW * 1_000_000
STEP = memory.PROGRAMS + memory.A_PIXEL * PIXELS


def fitted(monkeypatch, folder, free, *, may_lower=True):
    monkeypatch.setattr(memory, "free_memory", lambda: int(free))
    monkeypatch.setattr(memory, "computes_on_cpu", lambda: True)
    return fit_to_memory(PLAN, FRAMES, folder, may_lower=may_lower)


def test_photos_take_their_pixels_and_what_the_largest_phase_lays_beside_them():
    assert photo_bytes(PLAN, FRAMES) == PHOTOS + NORMALS
    coarse = plan(Settings(schedule=Schedule(phases=(Phase("coarse", 10, image_scale=2), Phase("all", 10)))))
    assert photo_bytes(coarse, FRAMES) == PHOTOS + PHOTOS // 4
    halved = plan(Settings(schedule=Schedule(phases=(Phase("surface", 10, Weights(sdf_normal=0.1), surface_scale=2),))))
    assert photo_bytes(halved, FRAMES) == PHOTOS + NORMALS + (PHOTOS + NORMALS) // 4


def test_photos_go_to_the_disk_before_gaussians_are_fewer(tmp_path, monkeypatch):
    planned, keep, lines = fitted(monkeypatch, tmp_path, STEP + GAUSSIANS + 1)
    assert planned is PLAN and isinstance(keep, ArraysOnDisk)
    [line] = lines
    assert f"photos and maps take {(PHOTOS + NORMALS) / 2**30:.3g} and Gaussians" in line and "from the disk" in line


def test_gaussians_are_as_many_as_fit_and_a_run_that_goes_on_keeps_its_number(tmp_path, monkeypatch):
    free = STEP + GAUSSIANS - memory.A_ROW * 400_000
    planned, _, lines = fitted(monkeypatch, tmp_path, free)
    assert planned.max_gaussians == pytest.approx(600_000, abs=1)
    assert lines[1] == f"memory: at most {planned.max_gaussians:,} Gaussians, instead of max_gaussians=1,000,000"
    assert fitted(monkeypatch, tmp_path, free, may_lower=False).plan is PLAN
    assert fitted(monkeypatch, tmp_path, 0).plan.max_gaussians == memory.FEWEST
