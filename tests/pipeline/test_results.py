"""What is made of a finished run: meshed, scored and drawn."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_graphs import small_lpips
from trained_run import FEW_POINTS

from gsjax import cli, pipeline
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.images import image_size, read_image
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.metrics import geometry
from gsjax.metrics.photos import score_images
from gsjax.pipeline import demo
from gsjax.runs.result import open_result, scene_of_run


def test_the_mesh_lies_on_the_scene_and_is_scored_with_the_images(run, run_mesh, tmp_path):
    file, report = run_mesh
    assert len(read_mesh(file).faces) == report["faces"] > 100
    assert (
        report["photo_refine"]["after"] < report["photo_refine"]["before"]
        and report["photo_refine"]["seen_share"] > 0.5
    )
    # Fewer than thirty steps on photos of forty pixels: near the surface, not on it.
    figures = pipeline.evaluate(run, mesh=file, lpips=[small_lpips(tmp_path / "vgg.onnx")[0]])
    json.dumps(figures)
    assert 0 < figures["lpips_vgg"] != figures["lpips_vgg_3dgs"] > 0
    assert figures["floor"]["chamfer"] < 5e-4 < figures["chamfer"] < 0.2
    assert figures["distances"] == "point to surface"
    assert 5 < figures["normal_error_deg"] < 90
    assert figures["psnr"] == pytest.approx(json_files.read(run / "manifest.json")["psnr"], abs=1e-3)
    assert 0 < figures["ssim"] < 1


def test_a_mesh_whose_photos_have_gone_is_made_as_the_gaussians_have_it(run, tmp_path, capsys):
    moved = shutil.copytree(run, tmp_path / "run")
    json_files.write(
        moved / "manifest.json", {**json_files.read(run / "manifest.json"), "scene": str(tmp_path / "gone")}
    )
    report = pipeline.mesh(moved, tmp_path / "mesh.ply", **FEW_POINTS)
    assert report["photo_refine"] is None
    message = f"mesh: continues without its photos: {moved}: its data set is no longer in {tmp_path / 'gone'}; "
    assert message in capsys.readouterr().err
    assert pipeline.mesh(run, tmp_path / "asked.ply", photo_refine=False, **FEW_POINTS) == report
    assert (tmp_path / "asked.ply").read_bytes() == (tmp_path / "mesh.ply").read_bytes()


def test_the_true_mesh_is_its_own_floor_and_one_away_from_it_loses_no_other_figure(run, scene, tmp_path, capsys):
    figures = pipeline.evaluate(run, mesh=scene / "gt_mesh.ply")
    assert figures["lpips_vgg_3dgs"] is None and "lpips_vgg" not in figures, "without weights"
    floor = figures["floor"]
    assert floor == {name: figures[name] for name in floor}
    assert max(floor["accuracy"], floor["completeness"], floor["chamfer"]) < 5e-4
    assert floor["fscore"] == 1.0 and floor["outward_share"] > 0.999
    # Differences of depth over two pixels see the truth's own curves and edges.
    assert floor["mesh_normal_error_median_deg"] < 8 and floor["mesh_depth_error"] < 5e-3
    assert floor["mesh_normal_error_deg"] < 0.5 * figures["normal_error_deg"]

    true = read_mesh(scene / "gt_mesh.ply")
    write_mesh(tmp_path / "far.ply", replace(true, vertices=true.vertices + np.float32([100, 0, 0])))
    json_files.write(tmp_path / "before.json", figures)
    assert cli.main(["eval", str(run), "--mesh", str(tmp_path / "far.ply"), "--json", str(tmp_path / "e.json")]) == 0
    scores, printed = json_files.read(tmp_path / "e.json"), capsys.readouterr()
    lost = {*geometry.SCORES, "mesh_normal_error_deg", "mesh_normal_error_median_deg", "mesh_normal_error_all_deg",
            "mesh_depth_error", "mesh_psnr", "mesh_ssim", "covered_psnr", "covered_ssim"}  # fmt: skip
    others = {**json_files.read(tmp_path / "before.json"), "mesh_covers": 0.0}
    assert scores == {**others, **dict.fromkeys(lost)} and lost < set(figures)
    (line,) = [line for line in printed.err.splitlines() if "is not scored: no surface of the mesh" in line]
    assert line.startswith(f"{run}: its mesh ")


def test_a_run_is_scored_at_other_sizes_of_its_photos(run, capsys):
    figures = pipeline.evaluate(run, zooms=[1, 0.5])
    assert figures["psnr_zoom_1"] == figures["psnr"] and figures["ssim_zoom_1"] == figures["ssim"]
    assert 5 < figures["psnr_zoom_0.5"] != figures["psnr"]
    whole, half = scene_of_run(run), scene_of_run(run, zoom=0.5)
    for frame, smaller in zip(whole.frames, half.frames, strict=True):
        assert (frame.name, frame.held_out) == (smaller.name, smaller.held_out)
        np.testing.assert_allclose(smaller.K[:2], frame.K[:2] / 2, rtol=1e-6)
        boxes = frame.pixels().image.astype(float).reshape(20, 2, 24, 2, 3).mean((1, 3))
        np.testing.assert_allclose(smaller.pixels().image, boxes, atol=0.51)
    capsys.readouterr()
    for zoom, fault in (("2", "there are none 2 times larger"), ("-1", "zoom=-1 is not a number above 0")):
        assert cli.main(["eval", str(run), "--zoom", zoom]) == 2
        message = capsys.readouterr().err
        assert fault in message and message.count("\n") == 1


def test_photos_that_were_damaged_since_are_left_out_of_the_scores_and_named(run, scene, tmp_path, capsys):
    """Of the two held-out photos one remains, with the score that it had; photos of training may go as well."""
    shutil.copytree(scene, tmp_path / "scene")
    shutil.copytree(run, tmp_path / "run")
    manifest = json_files.read(tmp_path / "run/manifest.json")
    json_files.write(tmp_path / "run/manifest.json", {**manifest, "scene": str(tmp_path / "scene")})
    (tmp_path / "scene/images/004.png").unlink()
    file = tmp_path / "scene/images/008.png"
    file.write_bytes(file.read_bytes()[:-40])
    first, result = scene_of_run(run).held_out_frames[:1], open_result(run)
    alone = score_images(result.gaussians, first, "white", depth_mode=result.depth_mode)["psnr"]
    scores = pipeline.evaluate(tmp_path / "run")
    assert scores["views"] == 1 and scores["psnr"] == pytest.approx(alone, abs=1e-4)
    stderr = capsys.readouterr().err
    assert "scene/images/004.png: no such image; 2 of 9 photos are left out: 004.png, 008.png\n" in stderr


def test_pictures_of_held_out_photos_have_their_size_and_show_them_roughly(run, scene, tmp_path):
    pipeline.render(run, tmp_path / "held_out", views="held_out")
    files = sorted((tmp_path / "held_out").iterdir())
    kinds = ("color", "depth", "normal")
    assert [file.name for file in files] == [f"{name}_{kind}.png" for name in ("000", "008") for kind in kinds]
    assert all(image_size(file) == (48, 40) for file in files)
    photo, rendered = (read_image(file)[0].astype(float) for file in (scene / "images/000.png", files[0]))
    assert np.abs(photo - rendered).mean() < 60


def test_the_demo_sets_a_run_with_normals_beside_one_without(run, run_mesh, run_scores, scene, tmp_path, monkeypatch):
    settings_by_run = {}

    def train(data_set, folder, settings, warm_start):
        settings_by_run[folder.name] = settings
        assert warm_start == (None if settings["schedule"]["vanilla"] else tmp_path / "demo/vanilla")
        shutil.copytree(run, folder)

    def mesh(folder, out, points):
        shutil.copy(run_mesh[0], out)
        return run_mesh[1]

    small = SimpleNamespace(train=train, mesh=mesh, evaluate=lambda folder: run_scores)
    monkeypatch.setattr(demo, "pipeline", small)
    monkeypatch.setattr(demo.analytic_scene, "write_built_in_scene", lambda folder, **_: scene)
    report = demo.run(tmp_path / "demo")
    assert [settings["schedule"]["vanilla"] for settings in settings_by_run.values()] == [True, False]
    assert {settings["supervision"]["normals"] for settings in settings_by_run.values()} == {str(scene / "normals")}
    assert report["vanilla"] == report["surface"], "both are one run here"
    assert report["floor"]["chamfer"] < 5e-4 < report["surface"]["chamfer"] < 0.2
    panels = read_image(report["picture"])[0].reshape(-1, 3)
    assert len(np.unique(panels, axis=0)) > 1000, "seven pictures and their titles"
    assert json_files.read(tmp_path / "demo/report.json")["floor"] == report["floor"]
    with pytest.raises(InputError, match="exists and is not empty"):
        demo.run(tmp_path / "demo")
