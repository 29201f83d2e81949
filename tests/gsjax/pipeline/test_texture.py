"""`gsjax texture` from files to files."""

import meshes
import numpy as np
import pytest
import small_scenes

from gsjax import cli
from gsjax.io import json_files, ply
from gsjax.io.images import write_image
from gsjax.meshing.export import read_textured, write_mesh

SIZE = 128


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of a striped wall at z = 4 that three cameras look at, and a mesh of it in grey."""
    folder = tmp_path_factory.mktemp("run")
    steps = np.linspace(-1.5, 1.5, 46)
    x, y = (part.ravel() for part in np.meshgrid(steps, steps))
    colors = np.where((x < 0)[:, None], [0.9, 0.1, 0.1], [0.1, 0.2, 0.8])
    wall = small_scenes.discs(np.stack([x, y, np.full(x.size, 4.0)], -1), [0, 0, -1.0], 0.05, colors=colors)
    ply.write_gaussians(folder / "gaussians.ply", wall)
    json_files.write(folder / "config.json", {"model": {"background": "white"}})
    cameras = [small_scenes.camera_at((at, 0.1, 0), (0, 0, 4), size=(64, 48), focal=60) for at in (-0.5, 0.0, 0.5, 1.0)]
    records = [
        {"name": f"{k}.png", "width": 64, "height": 48, "viewmat": c.viewmat, "K": c.K, "held_out": k == 3}
        for k, c in enumerate(cameras)
    ]
    json_files.write(folder / "cameras.json", records)
    write_mesh(folder / "grey.ply", meshes.turned(meshes.square(1, -1, 1, height=4.0, color=(128, 128, 128))))
    return folder


def test_a_grey_mesh_gets_the_colours_of_the_gaussians(folder, tmp_path, capsys):
    command = ["texture", str(folder), "--mesh", str(folder / "grey.ply"), "--out", str(tmp_path / "wall.obj")]
    assert cli.main([*command, "--size", str(SIZE)]) == 0
    report = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines() if line)
    assert int(report["faces"]) == 2
    assert float(report["seen_share"]) > 0.85
    textured = read_textured(tmp_path / "wall.obj")
    assert textured is not None
    assert textured.texture.shape == (SIZE, SIZE, 3)
    inner = np.array([[u, v] for u in (-0.5, 0.5) for v in (-0.5, 0.0, 0.5)])  # in the world, clear of the stripe
    colors = [_color_at(textured, point) for point in inner]
    expected = np.where(inner[:, :1] < 0, [0.9, 0.1, 0.1], [0.1, 0.2, 0.8])
    # The discs cover 0.97 of a pixel and its neighbours mix in: measured 0.02.
    assert np.abs(np.array(colors) / 255 - expected).max() < 0.05


def _color_at(textured, point):
    """The texel at a point (x, y) of the wall, through the triangle that holds it."""
    for corners, places in zip(
        textured.mesh.vertices[textured.mesh.faces], textured.atlas.uvs[textured.atlas.faces], strict=True
    ):
        weights = np.linalg.solve(np.vstack([corners[:, :2].T.astype(float), np.ones(3)]), [*point, 1])
        if weights.min() >= -1e-9:
            column, row = np.floor(weights @ places * SIZE).astype(int)
            return textured.texture[row, column]
    raise AssertionError(f"no triangle at {point}")


def test_where_photos_are_masked_the_mesh_keeps_its_own_colours(folder, tmp_path):
    for name in ("gaussians.ply", "config.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    records = json_files.read(folder / "cameras.json")
    x = np.arange(64) + 0.5
    for record in records:
        viewmat, K = np.array(record["viewmat"]), np.array(record["K"])
        on_wall = (x - K[0, 2]) / K[0, 0] * 4  # Roughly, the cameras look along z: x of the wall at z = 4.
        column = on_wall + (np.linalg.inv(viewmat) @ [0, 0, 4, 1])[0]
        record["mask"] = f"masks/{record['name']}"
        write_image(tmp_path / record["mask"], np.tile(np.where(column > 0.1, 255, 0).astype(np.uint8), (48, 1)))
    json_files.write(tmp_path / "cameras.json", records)
    command = ["texture", str(tmp_path), "--mesh", str(folder / "grey.ply"), "--out", str(tmp_path / "half.glb")]
    assert cli.main([*command, "--size", str(SIZE)]) == 0
    textured = read_textured(tmp_path / "half.glb")
    assert textured is not None
    assert np.all(np.abs(_color_at(textured, (-0.5, 0.2)).astype(int) - 128) <= 1)
    assert np.abs(_color_at(textured, (0.6, 0.2)) / 255 - [0.1, 0.2, 0.8]).max() < 0.05
