"""What is written of a COLMAP model is whole, or the error says that it is not."""

import os

import pycolmap
import pytest

from gsjax.errors import InputError
from gsjax.io.colmap_model import read_model
from gsjax.io.colmap_writer import write_whole


class OnAFullDisk:
    """A model whose writer loses the end of one file and says nothing, as pycolmap's does."""

    def __init__(self, model, name, share):
        self.model, self.name, self.share = model, name, share

    def __getattr__(self, name):
        return getattr(self.model, name)

    def write_binary(self, folder):
        self.model.write_binary(folder)
        os.truncate(folder / self.name, int(self.share * (folder / self.name).stat().st_size))


@pytest.mark.parametrize(
    ("name", "share"), [("cameras.bin", 0.0), ("images.bin", 0.5), ("points3D.bin", 0.99), ("rigs.bin", 0.5)]
)
def test_a_model_that_was_cut_by_a_full_disk_is_told(colmap_scene, tmp_path, name, share):
    model = pycolmap.Reconstruction(colmap_scene() / "sparse/0")
    with pytest.raises(InputError, match="cannot write .*out: the model did not come whole onto the disk, which has"):
        write_whole(OnAFullDisk(model, name, share), tmp_path / "out")
    write_whole(model, tmp_path / "out")
    assert len(read_model(tmp_path / "out").images) == 10


def test_a_folder_that_cannot_be_written_is_told(colmap_scene, tmp_path):
    model = pycolmap.Reconstruction(colmap_scene() / "sparse/0")
    (tmp_path / "out/points3D.bin").mkdir(parents=True)
    with pytest.raises(InputError, match="cannot write .*out"):
        write_whole(model, tmp_path / "out")
