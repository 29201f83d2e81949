"""Files of Gaussians by suffix, as `gsjax.load_gaussians` and `gsjax.save_gaussians` find them."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from small_scenes import cloud

import gsjax
from gsjax.errors import InputError
from gsjax.gaussians import take
from gsjax.io import gaussian_files


def test_what_holds_no_gaussians_is_one_line(tmp_path):
    faults = {"absent.ply": "no such file or folder", "": "holds no gaussians.ply; it is no run folder"}
    for name, fault in faults.items():
        with pytest.raises(InputError, match=fault):
            gsjax.load_gaussians(tmp_path / name)
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="its training has not finished"):
        gsjax.load_gaussians(tmp_path)
    (tmp_path / "scene.obj").write_text("")
    for attempt in (gsjax.load_gaussians, lambda path: gsjax.save_gaussians(cloud(2), path)):
        with pytest.raises(InputError, match="files of Gaussians end in .compressed.ply, .ply, .sog, .spz"):
            attempt(tmp_path / "scene.obj")


@pytest.mark.parametrize("name", ["g.spz", "g.compressed.ply"])
def test_a_file_of_local_coordinates_is_never_without_what_tells_them(tmp_path, monkeypatch, name):
    """The disk is full when the similarity is written, and the Gaussians lie where nobody could tell."""
    far = replace(cloud(30), means=np.asarray(cloud(30).means, np.float64) + 4.5e6)
    full = InputError("cannot write: No space left on device")
    monkeypatch.setattr(gaussian_files.json_files, "write", Mock(side_effect=full))
    with pytest.raises(InputError, match="No space left"):
        gsjax.save_gaussians(far, tmp_path / name)
    monkeypatch.undo()
    with pytest.raises(InputError, match=f"{name}: Gaussians that are so far off have no place in it"):
        gsjax.save_gaussians(replace(far, means=far.means * [0, 1, 1] + [1e30, 0, 0]), tmp_path / name)
    assert not list(tmp_path.iterdir())
    gsjax.save_gaussians(far, tmp_path / name)
    np.testing.assert_allclose(gsjax.load_gaussians(tmp_path / name).means.mean(0), far.means.mean(0), atol=1e-2)


def test_free_rows_of_a_buffer_are_not_written(tmp_path):
    buffer = cloud(10, capacity=100)
    for name, gaussians in (("a.SPZ", buffer), ("alone.spz", take(buffer, slice(10)))):
        gsjax.save_gaussians(gaussians, str(tmp_path / name))
    assert gsjax.load_gaussians(str(tmp_path / "a.SPZ")).num_gaussians == 10
    assert (tmp_path / "a.SPZ").read_bytes() == (tmp_path / "alone.spz").read_bytes()
