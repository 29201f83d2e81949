"""Maps that are wrong by what their names say, smoothly, and alike from run to run."""

from pathlib import Path

import numpy as np
import pytest
from photographed_wall import wall, written

from gsjax.errors import InputError
from gsjax.io.normal_maps import normal_maps
from gsjax.io.scenes import load_scene


@pytest.fixture
def script(scripts):
    return scripts("perturb_normals")


@pytest.fixture
def scene(tmp_path):
    """A wall whose true normals slant more and more, with a stripe that has none."""
    made = wall(3)
    written(made, tmp_path / "scene")
    for frame in made.frames:
        slant = np.linspace(-1, 1, frame.width)[None, :, None] * np.ones((frame.height, 1, 1))
        normals = np.concatenate([slant, 0 * slant, -np.ones_like(slant)], -1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        normals[:5] = 0
        folder = tmp_path / "scene/normals"
        folder.mkdir(exist_ok=True)
        np.savez(folder / f"{Path(frame.name).stem}.npz", cam=normals.astype(np.float32))
    return tmp_path / "scene"


def angles(a, b):
    return np.degrees(np.arccos(np.clip(np.sum(a.astype(np.float64) * b, -1), -1, 1)))


def test_the_maps_are_wrong_by_what_they_are_called(script, scene):
    script.run(str(scene), str(scene))
    frames = load_scene(scene).frames
    true = normal_maps(scene / "normals", frames)
    for degrees in (5, 10, 20):
        wrong = normal_maps(scene / f"normals_{degrees}deg", frames)
        for frame in frames:
            before, after = true[frame.name](), wrong[frame.name]()
            there = np.any(before != 0, -1)
            np.testing.assert_array_equal(np.any(after != 0, -1), there)
            off = angles(before, after)
            assert off[there].mean() == pytest.approx(degrees, abs=0.1)
            neighbors = angles(after[6:, 1:], after[6:, :-1])
            assert neighbors.max() < 0.3 * degrees + 1.5  # smooth: the wall itself turns by up to one a pixel
    partly = normal_maps(scene / "normals_fifth_wrong", frames)
    for frame in frames:
        before, after = true[frame.name](), partly[frame.name]()
        there = np.any(before != 0, -1)
        wrong = angles(before, after)[there] > 0.5
        assert wrong.mean() == pytest.approx(0.2, abs=0.02)
        directions = after[there][wrong]
        assert np.ptp(directions, axis=0).max() < 2e-3 and directions[0, 2] < 0


def test_a_seed_is_a_map_and_what_is_there_is_not_written_over(script, scene, tmp_path):
    script.run(str(scene), str(tmp_path / "a"))
    script.run(str(scene), str(tmp_path / "b"))
    script.run(str(scene), str(tmp_path / "c"), seed=1)
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.npy"))
    assert len(files) == 12
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
        assert (tmp_path / "a" / file).read_bytes() != (tmp_path / "c" / file).read_bytes()
    with pytest.raises(InputError, match="exists and is not empty"):
        script.run(str(scene), str(tmp_path / "a"))
