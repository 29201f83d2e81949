"""No command writes onto what it reads; what it made before, it may make again."""

import pytest

from gsjax import cli, runs
from gsjax.errors import InputError
from gsjax.runs.outputs import require_apart


@pytest.fixture
def scene(tmp_path):
    for name in ("images/a.png", "transforms.json", "points3D.ply", "diagnosis.json", "mine/a.png"):
        (tmp_path / "scene" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "scene" / name).write_bytes(b"")
    return tmp_path / "scene"


@pytest.fixture
def run(scene, tmp_path):
    return runs.create(tmp_path / "run", {"seed": 0}, scene=scene, seed=0)


def test_files_of_a_run_and_of_its_data_set_are_refused(scene, run):
    for name in ("config.json", "checkpoints/step_0000001.npz", "../run/gaussians.ply", "."):
        with pytest.raises(InputError, match=r": is what is read from .*run; choose another place for the output"):
            require_apart(run / name, run)
    for name in ("images/a.png", "transforms.json", "points3D.ply", "mine/a.png"):
        for source in (scene, run):
            with pytest.raises(InputError, match="is what is read from"):
                require_apart(scene / name, source)
    require_apart(scene / "diagnosis.json", scene)
    require_apart(scene / "mesh.ply", scene)


def test_one_file_is_known_by_all_its_names(tmp_path, monkeypatch):
    (tmp_path / "g.ply").write_bytes(b"")
    (tmp_path / "link.ply").symlink_to("g.ply")
    (tmp_path / "hard.ply").hardlink_to(tmp_path / "g.ply")
    monkeypatch.chdir(tmp_path)
    for name in ("g.ply", "link.ply", "hard.ply", "./x/../g.ply"):
        with pytest.raises(InputError, match="is what is read from g.ply"):
            require_apart(name, None, "g.ply")
    require_apart("other.ply", "g.ply")


def test_every_command_with_an_output_refuses_its_inputs_before_any_work(scene, run, tmp_path, capsys):
    mesh, gaussians = tmp_path / "mesh.glb", run / "gaussians.ply"
    for file in (mesh, gaussians):
        file.write_bytes(b"kept")
    (tmp_path / "turn.gif").symlink_to(mesh)
    for command in (
        ["mesh", run, "--out", gaussians],
        ["texture", run, "--mesh", mesh, "--out", mesh],
        ["convert", gaussians, gaussians],
        ["render", run, "--out", run / "pictures"],
        ["render", mesh, "--turntable", "--out", tmp_path / "turn.gif"],
        ["compare", run, tmp_path, "--out", run / "report.html"],
        ["diagnose", scene, "--json", scene / "transforms.json"],
        ["eval", run, "--json", run / "manifest.json"],
        ["eval", run, "--mesh", mesh, "--json", mesh],
    ):
        assert cli.main([str(part) for part in command]) == 2, command
        error = capsys.readouterr().err
        assert "is what is read from" in error and error.count("\n") == 1, error
    for command in (
        ["train", scene, "--out", scene],
        ["refine", run, "--mesh", mesh, "--out", run],
        ["undistort", scene, "--out", scene],
        ["sfm", scene / "images", "--out", scene / "images"],
        ["scan", scene, "--out", scene],
    ):
        assert cli.main([str(part) for part in command]) == 2, command
        assert "not empty" in capsys.readouterr().err, command
    assert mesh.read_bytes() == gaussians.read_bytes() == b"kept"
