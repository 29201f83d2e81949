import errno
import os
import subprocess
import sys

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io import files, temporary_files


def test_the_target_appears_whole_with_its_parents(tmp_path):
    target = tmp_path / "a/b/mesh.ply"
    with files.atomic_path(target) as temporary:
        temporary.write_text("whole")
        assert temporary.parent == target.parent
        assert temporary.suffix == ".ply"
        assert not target.exists()
    assert target.read_text() == "whole"
    assert os.listdir(target.parent) == ["mesh.ply"]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "a/scene"
    with files.atomic_folder(target) as folder:
        (folder / "images").mkdir()
        assert not target.exists()
    assert os.listdir(target) == ["images"] and os.listdir(tmp_path / "a") == ["scene"]
    with pytest.raises(InputError, match="scene: exists and is not empty"), files.atomic_folder(target):
        pass
    with (
        pytest.raises(InputError, match="cannot write .*other: No space left"),
        files.atomic_folder(tmp_path / "other"),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert os.listdir(tmp_path) == ["a"]


def test_a_full_disk_is_one_line_with_the_path_and_the_reason(tmp_path):
    target = tmp_path / "state.npz"
    target.write_text("old")
    with pytest.raises(InputError) as caught, files.atomic_path(target) as temporary:
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert str(caught.value) == f"cannot write {target}: No space left on device"
    assert target.read_text() == "old" and os.listdir(tmp_path) == ["state.npz"]
    with pytest.raises(InputError, match=r"cannot write .*npz/x\.json: "), files.atomic_path(target / "x.json"):
        pass
    with pytest.raises(InputError, match="cannot write .*npz: File exists"):
        files.make_folder(target)


def test_a_file_comes_to_where_a_link_leads(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "mesh.ply").symlink_to(tmp_path / "disk/of_today.ply")
    for text in ("first", "second"):
        with files.atomic_path(tmp_path / "mesh.ply") as temporary:
            temporary.write_text(text)
        assert (tmp_path / "mesh.ply").is_symlink()
        assert (tmp_path / "disk/of_today.ply").read_text() == text
    assert os.listdir(tmp_path / "disk") == ["of_today.ply"]


def test_a_file_larger_than_memory_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "huge.ply").open("wb") as file:
        os.truncate(file.fileno(), 1 << 43)
    with pytest.raises(InputError, match="huge.ply: a file of .* GiB takes"):
        files.read_bytes(tmp_path / "huge.ply")


def kill_writer(target, function, half):
    """Begins to write a file or a folder in a process that ends at once."""
    killed = f"import os, sys\nfrom gsjax.io.files import {function}\nwith {function}(sys.argv[1]) as path:\n"
    killed += f"    {half}.write_text('half')\n    os._exit(9)"
    assert subprocess.run([sys.executable, "-c", killed, str(target)]).returncode == 9
    assert not target.exists()


def test_the_folder_of_a_killed_writer_goes_when_the_next_one_begins(tmp_path):
    for name in ("scene", "other"):
        kill_writer(tmp_path / name, "workspace", "(path / 'half')")
    (tmp_path / ".scene-0123abcd").mkdir()
    assert len(os.listdir(tmp_path)) == 3
    with files.atomic_folder(tmp_path / "scene") as folder:
        (folder / "whole").write_text("whole")
    entries = sorted(os.listdir(tmp_path))
    assert entries[0].startswith(".other.gsjax-"), "may be of a writer on another machine"
    assert entries[1:] == [".scene-0123abcd", "scene"] and os.listdir(tmp_path / "scene") == ["whole"]


def test_what_a_killed_writer_left_is_swept_away_and_nothing_else(tmp_path):
    target = tmp_path / "a/step_0000001.npz"
    kill_writer(target, "atomic_path", "path")
    mine = [".hidden-file", ".notes-0123abcd.npz", "step-0123abcd.npz", "step.gsjax-1-0123abcd.npz"]
    for name in mine:
        (tmp_path / name).write_text("the user's")
    assert len(os.listdir(target.parent)) == 1
    with files.atomic_path(target) as living:
        living.write_text("half")
        temporary_files.sweep(tmp_path)
        assert os.listdir(target.parent) == [living.name], "of a process that lives"
    assert os.listdir(target.parent) == [target.name]
    assert sorted(os.listdir(tmp_path)) == [mine[0], mine[1], "a", *mine[2:]]


def test_arrays_lie_on_the_disk_as_they_are_in_as_many_files_as_it_takes(tmp_path, monkeypatch):
    monkeypatch.setattr(temporary_files, "FILE", 4096)
    rng = np.random.default_rng(0)
    larger, in_turn = rng.random((40, 50)) > 0.5, rng.normal(size=(30, 100)).astype(np.float32)[:, ::2]
    keep = temporary_files.ArraysOnDisk(tmp_path / "not" / "there")
    for array in (rng.integers(0, 256, (17, 19, 3), dtype=np.uint8), larger, in_turn, np.empty((0, 3), np.uint8)):
        copy = keep(array)
        np.testing.assert_array_equal(copy, array, strict=True)
        assert keep(copy) is copy and not copy.flags.writeable or not copy.size, "what lies there is not copied"
    assert os.listdir(tmp_path) == [], "its files have no names, and go with the process"
