"""Runs beside each other: which panels there are, what lies under what, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.scene import Pixels, Truth, frame_of

SIZE = (2, 3, 3)


def flat(value: int) -> np.ndarray:
    return np.full(SIZE, value, np.uint8)


@pytest.fixture
def script(scripts, monkeypatch, tmp_path):
    """The module, with pictures of one value each: normals 20, meshes 30, photos 40, renders 51; panels in `drawn`."""
    module, drawn = scripts("side_by_side"), {}
    truth = Truth(normals={"a.png": lambda: np.zeros(SIZE)}, mesh=tmp_path / "gt_mesh.ply")
    frame = frame_of("a.png", np.eye(4), np.eye(3), Pixels(flat(40)), held_out=True)
    result = SimpleNamespace(gaussians=0, background=0, depth_mode="plane", cameras=("A",), names=("a.png",))
    picture = SimpleNamespace(colors=np.full(SIZE, 0.2), depth=0)
    monkeypatch.setattr(
        "gsjax.runs.result.scene_of_run", lambda run: SimpleNamespace(held_out_frames=(frame,), truth=truth)
    )
    monkeypatch.setattr("gsjax.runs.result.open_result", lambda run: result)
    monkeypatch.setattr("gsjax.render.gallery.pictures", lambda *_: iter([picture]))
    monkeypatch.setattr("gsjax.report.pictures.surface_picture", lambda depth, camera: flat(20))
    monkeypatch.setattr("gsjax.meshing.read_mesh", lambda file: file.parent.name)
    monkeypatch.setattr("gsjax.report.pictures.mesh_picture", lambda mesh, camera: flat(30))
    monkeypatch.setattr(module, "draw_panels", lambda panels, path, columns: drawn.update(panels))
    for name in ("plain_0", "another variant of the same thing_12"):
        (tmp_path / name).mkdir()
    (tmp_path / "plain_0/mesh.ply").touch()
    return SimpleNamespace(module=module, drawn=drawn, runs=[str(p) for p in sorted(tmp_path.iterdir())], result=result)


def column(panel: np.ndarray) -> list[int]:
    """The value of each picture of a panel."""
    assert panel.shape[0] % SIZE[0] == 0 and panel.shape[1:] == SIZE[1:]
    return panel[:: SIZE[0], 0, 0].tolist()


def test_a_run_has_its_render_its_normals_and_its_mesh_under_its_name_without_the_seed(script):
    titles = script.module.draw(script.runs, "out.png")
    assert titles == ["photo and truth", "another variant of the\nsame thing", "plain"] == list(script.drawn)
    photo, unmeshed, plain = map(column, script.drawn.values())
    assert photo == [40, 255, 30], "a normal that is not known is white"
    assert plain == [51, 20, 30]
    assert unmeshed == [51, 20, 255]


def test_without_any_mesh_there_is_no_row_of_meshes(script, tmp_path):
    (tmp_path / "plain_0/mesh.ply").unlink()
    script.module.draw(script.runs, "out.png")
    assert list(map(column, script.drawn.values())) == [[40, 255], [51, 20], [51, 20]]


def test_two_seeds_of_one_variant_are_refused(script):
    with pytest.raises(InputError, match=r"plain_0: another run has this name"):
        script.module.draw([*script.runs, script.runs[-1]], "out.png")
    assert not script.drawn


def test_what_is_no_view_of_all_runs_is_refused_by_name(script):
    with pytest.raises(InputError, match=r"holds out 1 views; there is no view 1$"):
        script.module.draw(script.runs, "out.png", view=1)
    script.result.names = ("b.png",)
    with pytest.raises(InputError, match=r"has no view a\.png"):
        script.module.draw(script.runs, "out.png")
