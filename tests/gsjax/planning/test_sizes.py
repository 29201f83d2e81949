"""Photos that a run reads: at which size, and in which memory."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.errors import InputError
from gsjax.io.temporary_files import ArraysOnDisk
from gsjax.planning import memory
from gsjax.planning.memory import fit_to_memory
from gsjax.planning.preparation import read_photos
from gsjax.planning.sizes import chosen_downscale
from gsjax.scene import Frame, in_memory, with_pixels
from gsjax.settings import Model, Phase, Photos, Schedule, Settings, Weights
from gsjax.training.plan import plan

EYE = np.eye(4, dtype=np.float32)


def photo(width, height):
    return Frame("a.jpg", EYE, EYE[:3, :3], width, height, pixels=lambda: pytest.fail("sizes need no pixels"))


@pytest.mark.parametrize(
    ("sizes", "settings", "on_cpu", "expected"),
    [
        ([(1600, 1200), (900, 1600)], {}, True, 1.0),
        ([(800, 600), (3000, 4000)], {}, True, 2.5),  # the largest decides
        ([(4000, 3000)], {"downscale": 4.5}, False, 4.5),
        ([(4000, 3000)], {"longest_side": 1000}, False, 4.0),
        ([(2000, 1000)], {"cpu_pixels": 125_000}, True, 4.0),
        ([(2000, 1000)], {"cpu_pixels": 125_000}, False, 1.25),
        ([(300, 200)], {"cpu_pixels": 125_000}, True, 1.0),  # never larger than they are
    ],
)
def test_the_size_is_the_users_or_what_the_largest_photo_and_the_machine_bear(sizes, settings, on_cpu, expected):
    frames = [photo(*size) for size in sizes]
    assert chosen_downscale(Photos(**settings), frames, on_cpu=on_cpu) == expected


PHASES = (Phase("coarse", 100, image_scale=2), Phase("vanilla", 200), Phase("surface", 50, Weights(sdf_normal=0.1)))


PIXELS, MASKED = 1000 * 800, 2
FRAMES = [replace(photo(1000, 800), name=f"{i}.jpg", masked=i < MASKED) for i in range(100)]
PLAN = plan(Settings(schedule=Schedule(phases=PHASES), model=Model(max_gaussians=1_000_000)))
PHOTOS, NORMALS = 3 * 100 * PIXELS + MASKED * PIXELS, 3 * 100 * PIXELS
GAUSSIANS = memory.A_ROW * 1_000_000
STEP = memory.PROGRAMS + memory.A_PIXEL * PIXELS


def fitted(monkeypatch, folder, free, *, may_lower=True):
    monkeypatch.setattr(memory, "free_memory", lambda: int(free))
    monkeypatch.setattr(memory, "computes_on_cpu", lambda: True)
    return fit_to_memory(PLAN, FRAMES, folder, may_lower=may_lower)


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


def test_masks_that_leave_nothing_are_refused():
    scene = wall(3)
    bare = [with_pixels(f, f.pixels()._replace(valid=np.zeros((f.height, f.width), np.uint8))) for f in scene.frames]
    assert len(read_photos(replace(scene, frames=(*bare[:2], scene.frames[2])), in_memory).frames) == 3
    with pytest.raises(InputError, match="wall: its masks leave no pixel of any photo"):
        read_photos(replace(scene, frames=tuple(bare)), in_memory)
