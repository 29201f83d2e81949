"""`gsjax refine` on a tiny run: what it writes, how it goes on, and what it refuses."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from meshes import square, turned
from small_scenes import camera_at, plane

from gsjax import cli, config, pipeline, runs
from gsjax.binding.refinement import PRESETS, Refinement
from gsjax.errors import InputError
from gsjax.io import json_files, photos
from gsjax.io.images import read_image, write_image
from gsjax.io.ply import read_gaussians, write_gaussians
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.pipeline.refine import halved_where_seen, prepare_mesh
from gsjax.runs.result import open_result, write_views
from gsjax.scene import Pixels, frame_of
from gsjax.scene.batches import read_batches
from gsjax.scene.meshes import Mesh
from gsjax.settings import Model, Photos, Settings

SETTINGS = Refinement(
    steps=4, per_triangle=3, sh_degree=1, thickness=1e-3, photo_refine_at=0.75, weights={"edges": 0.1, "far": 1e-3}
)
BOUND = 54  # three on each of 18 triangles


def edges(gaussians, view, batch):
    """Mean squared difference of corners, over edges and axes: a term of one's own."""
    corners = view.mesh.vertices[view.mesh.faces]
    return jnp.mean(jnp.square(corners - jnp.roll(corners, 1, axis=1)))


TERMS = {"edges": edges, "far": lambda gaussians, view, batch: jnp.max(view.depth)}


def sheet(depth=4.0) -> Mesh:
    """Four by four bumpy vertices about (0, 0, `depth`)."""
    height = depth + 0.2 * np.random.default_rng(0).normal(size=(4, 4))
    return turned(square(3, -1, 1, height=height, color=np.random.default_rng(1).integers(0, 255, (16, 3))))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A data set of nine photos of noise, and a run folder that names it, with a mesh and Gaussians beyond it too."""
    root = tmp_path_factory.mktemp("refine")
    scene, run = root / "scene", root / "run"
    rng, frames = np.random.default_rng(2), []
    for index in range(9):
        camera = camera_at((0.2 * index - 0.8, 0.1 * index, 0.0), (0.0, 0.0, 4.0), size=(24, 24))
        (scene / "images").mkdir(parents=True, exist_ok=True)
        write_image(scene / f"images/{index}.png", rng.integers(0, 255, (24, 24, 3), dtype=np.uint8))
        pose = np.linalg.inv(np.asarray(camera.viewmat, np.float64)) @ np.diag([1, -1, -1, 1])
        frames.append({"file_path": f"images/{index}.png", "transform_matrix": pose.tolist()})
    (scene / "transforms.json").write_text(json.dumps({"fl_x": 30.0, "frames": frames}))
    runs.create(
        run, config.to_dict(Settings(photos=Photos(downscale=1), model=Model(background="white"))), scene=scene, seed=0
    )
    write_mesh(run / "mesh.ply", sheet())
    write_gaussians(run / "gaussians.ply", plane((0, 0, -1), per_side=9, spacing=0.4, radius=0.3))
    write_views(run, load_scene(scene, downscale=1).frames)
    return SimpleNamespace(root=root, run=run, scene=scene)


@pytest.fixture(scope="module")
def refined(place):
    out = place.root / "refined"
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(pipeline.refine.__globals__, "SAVED_EVERY", 2)
        read = []
        patched.setattr(photos, "read_image", lambda path: read.append(path.name) or read_image(path))
        report = pipeline.refine(place.run, out, SETTINGS, terms=TERMS)
        return SimpleNamespace(out=out, report=report, read=read)


def test_the_folder_holds_mesh_gaussians_and_report_and_is_a_run(place, refined):
    report = json_files.read(refined.out / "report.json")
    assert report == refined.report
    assert (report["faces"], report["vertices"], report["bound"], report["steps"]) == (18, 16, BOUND, 4)
    assert report["gaussians"] == BOUND + report["free"] == read_gaussians(refined.out / "gaussians.ply").num_gaussians
    assert report["taken_out"] == {"degenerate": 0, "duplicate": 0, "non_manifold": 0, "decimated": 0}
    mesh, coarse = read_mesh(refined.out / "mesh.ply"), read_mesh(place.run / "mesh.ply")
    np.testing.assert_array_equal(mesh.faces, coarse.faces)
    assert 1e-4 < np.abs(mesh.vertices - coarse.vertices).max() < 0.3
    # Photos of noise agree nowhere, but better in some places than in others.
    assert report["photo_refine"]["moved_px"] > 0 and report["photo_refine"]["after"] < report["photo_refine"]["before"]
    np.testing.assert_allclose(read_mesh(refined.out / "mesh.glb").vertices, mesh.vertices, atol=1e-6)
    manifest = json_files.read(refined.out / "manifest.json")
    assert manifest["status"] == "done" and manifest["scene"] == str(place.scene)
    assert {"mesh.ply", "mesh.glb", "gaussians.ply", "cameras.json", "report.json"} <= set(manifest["files"])
    scores = pipeline.evaluate(refined.out)
    assert scores["views"] == 2 and scores["psnr"] == pytest.approx(report["psnr"], abs=1e-3)
    assert (open_result(place.run).depth_mode, open_result(refined.out).depth_mode) == ("plane", "discs")
    assert sorted(refined.read) == [f"{index}.png" for index in range(9)], "every photo is read once"
    assert refined.read[-2:] == ["0.png", "8.png"], "those held out are read last"


def test_a_term_of_ones_own_is_evaluated_and_recorded(refined):
    """In the last step, before which the mesh was moved for the last time."""
    mesh = read_mesh(refined.out / "mesh.ply")
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float64)[mesh.faces], 1, 0)
    last = runs.read_metrics(refined.out)[-1]
    assert last["terms"]["edges"] == pytest.approx(np.mean([(a - b) ** 2, (b - c) ** 2, (c - a) ** 2]), rel=1e-5)
    assert 3.5 < last["terms"]["far"] < 5, "all is about 4 away"
    (phase,) = json_files.read(refined.out / "plan.json")["phases"]
    assert (phase["terms"]["edges"], phase["needs"]) == (0.1, ["depth", "gaussians", "matte", "mesh"])


def test_the_parts_of_a_mesh_stay_and_what_goes_is_said(capsys):
    rest = sheet(depth=9.0)
    corners = np.concatenate([sheet().vertices, rest.vertices[[0, 1, 4]]])
    faces = np.concatenate([sheet().faces, [[16, 17, 18]], [[0, 0, 1], [16, 17, 18]]])
    source = Mesh(corners, faces.astype(np.int32), np.zeros((19, 3), np.uint8))
    mesh, taken_out = prepare_mesh(source, 1000)
    assert mesh.num_faces == 19 and mesh.vertices[:, 2].max() > 8, "a part of one triangle stays"
    assert taken_out == {"degenerate": 1, "duplicate": 1, "non_manifold": 0, "decimated": 0}
    assert capsys.readouterr().err == "refine: 19 of 21 triangles are left; 1 degenerate, 1 duplicate\n"
    fewer, taken_out = prepare_mesh(sheet(), 10)
    assert fewer.num_faces <= 10 and taken_out["decimated"] == 18 - fewer.num_faces


def test_triangles_are_halved_where_pixels_see_them_and_are_not_masked(capsys):
    coarse, taken_out = prepare_mesh(sheet(), 16, halved_share=0.5)
    assert coarse.num_faces <= 8 and taken_out["decimated"] == 18 - coarse.num_faces
    camera = camera_at(size=(64, 48), focal=80.0)
    right = np.zeros((48, 64), np.uint8)
    right[:, 40:] = 255
    pixels = Pixels(np.zeros((48, 64, 3), np.uint8), valid=right)
    views = read_batches([frame_of("0.png", np.asarray(camera.viewmat), np.asarray(camera.K), pixels)])
    halved = halved_where_seen(coarse, views, 100)
    assert 99 <= halved.num_faces <= 100
    middles = halved.vertices[halved.faces].mean(axis=1)
    assert np.sum(middles[:, 0] > 0) > 2.5 * np.sum(middles[:, 0] < -0.3)
    assert "refine: 100 triangles after halving those that most pixels see" in capsys.readouterr().err


def test_gaussians_of_the_run_stay_where_there_is_no_mesh(place, refined):
    """The mesh ends at 1 along x and y, the run's Gaussians, 0.4 apart, at 1.6."""
    before, after = read_gaussians(place.run / "gaussians.ply"), read_gaussians(refined.out / "gaussians.ply")
    free = after.means[BOUND:]
    apart = np.linalg.norm(free[:, None] - before.means, axis=-1)
    stayed, reach = apart.argmin(axis=1), np.abs(before.means[:, :2]).max(axis=1)
    assert 1e-6 < apart.min(axis=1).max() < 0.01, "trained for four steps"
    assert refined.report["free"] == len(free) == len(set(stayed))
    assert set(np.flatnonzero(reach > 1.5)) <= set(stayed) and reach[stayed].min() > 0.7
    assert after.pixel_filter == "mip" and after.sh_rest.shape[1] == 3


def test_a_stopped_refinement_goes_on_to_the_same_bytes(place, refined, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(refined.out, out)
    for left_by_the_end in ("mesh.ply", "gaussians.ply", "checkpoints/step_0000004.npz"):
        (out / left_by_the_end).unlink()
    assert runs.latest_checkpoint(out)[0] == 2
    with pytest.raises(InputError, match=r"was started with terms=\{edges, far\}, not with no terms="):
        pipeline.refine(place.run, out, SETTINGS, resume=True)
    pipeline.refine(place.run, out, SETTINGS, terms=TERMS, resume=True)
    for name in ("mesh.ply", "gaussians.ply"):
        assert (out / name).read_bytes() == (refined.out / name).read_bytes()
    with pytest.raises(InputError, match="refinement.steps = 4, not 5; a resumed run keeps its settings"):
        pipeline.refine(place.run, out, replace(SETTINGS, steps=5), terms=TERMS, resume=True)


def test_what_cannot_be_refined_is_one_line_and_leaves_nothing(place, refined, tmp_path, capsys):
    write_mesh(tmp_path / "behind.ply", sheet(depth=-4.0))
    bare = tmp_path / "bare"
    runs.create(bare, config.to_dict(Settings(photos=Photos(downscale=1))), scene=place.scene, seed=0)
    cases = [
        ([str(place.run), "--mesh", str(tmp_path / "none.ply")], "none.ply: no such mesh file"),
        ([str(place.run), "--mesh", str(tmp_path / "behind.ply")], "sees any of its 18 triangles"),
        ([str(bare)], f"{bare}/mesh.ply: no such mesh; `gsjax mesh {bare} --out {bare}/mesh.ply` makes it"),
        ([str(place.run), "--set", "weights.l2=1"], "weights.l2: no such term of the loss; the nearest known"),
        ([str(place.run), "--set", "weights.sky=1"], "which a refinement does not have"),
        ([str(place.run), "--set", "weights.entropy=1"], "the loss term 'entropy' cannot be computed"),
        ([str(tmp_path / "norun"), "--mesh", str(place.run / "mesh.ply")], "norun: no such folder"),
    ]
    for arguments, message in cases:
        assert cli.main(["refine", *arguments, "--out", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err.splitlines()
        assert message in error[-1] and error[-1].startswith("gsjax: error: ")
        assert not (tmp_path / "out").exists()
    assert cli.main(["refine", str(place.run), "--out", str(refined.out)]) == 2
    assert "this folder is not empty" in capsys.readouterr().err


def test_the_command_hands_over_its_settings(monkeypatch, capsys):
    calls = []
    monkeypatch.setattr(pipeline, "refine", lambda *args, **kwargs: calls.append((args, kwargs)) or {"psnr": 30.0})
    assert tuple(PRESETS) == cli.refine.PRESETS
    assert cli.main(["refine", "run", "--out", "o"]) == 0
    assert calls.pop() == (("run", "o", config.parse(Refinement, PRESETS["fast"])), {})
    assert "psnr  30" in capsys.readouterr().out
    options = ["--preset", "medium", "--faces", "500", "--per-triangle", "6", "--mesh", "m.obj"]
    switches = ["--resume", "--bound-only", "--no-photo-refine", "--set", "weights.alpha=2", "opacity=0.5"]
    assert cli.main(["refine", "run", "--out", "o", *options, *switches]) == 0
    ((_, _, settings), keywords) = calls.pop()
    changes = {"faces": 500, "per_triangle": 6, "keep_free": False, "photo_refine_at": 1.0, "opacity": 0.5}
    changes["weights"] = {"alpha": 2.0}
    assert settings == config.parse(Refinement, config.merge(PRESETS["medium"], changes))
    assert keywords == {"mesh": "m.obj", "resume": True}
