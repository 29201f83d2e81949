"""The whole road on a small scene: trained, stopped and continued, meshed, scored and drawn."""

import json
import shutil
from pathlib import Path

import jax
import numpy as np
import pycolmap
import pytest
from jax.experimental.compilation_cache import compilation_cache
from small_graphs import small_lpips
from small_scenes import built_in

from gsjax import cli, config, pipeline
from gsjax.errors import InputError
from gsjax.io import runs
from gsjax.io.checkpoints import load_arrays
from gsjax.io.images import image_size, read_image, read_mask, write_image
from gsjax.io.ply import read_gaussians
from gsjax.meshing.export import read_mesh
from gsjax.pipeline import viewpoints
from gsjax.pipeline.result import open_result, scene_of_run
from gsjax.settings import Settings
from gsjax.training import harmonics

SETTINGS = {
    "background": "white",
    "max_gaussians": 900,
    "sh_degree": 1,
    "sh_every": 10,
    "phases": [
        {"name": "coarse", "steps": 12, "image_scale": 2, "density_control": True},
        {"name": "entropy", "steps": 8, "weights": {"entropy": 0.1}, "cull_below": 0.05},
        {"name": "surface", "steps": 10, "weights": {"sdf_normal": 0.2}},
    ],
    "density": {"start": 2, "stop": 12, "every": 4, "reset_every": 0},
    "logging": {"metrics_every": 5, "evaluate_every": 15, "checkpoint_every": 7},
}

MASK = np.where(np.arange(48) < 44, np.uint8(255), np.uint8(0))[None] * np.ones((40, 1), np.uint8)


@pytest.fixture(scope="module", autouse=True)
def programs(tmp_path_factory):
    """The same few programs run again and again here: each is compiled once."""
    options = {
        "jax_compilation_cache_dir": str(tmp_path_factory.mktemp("programs")),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
    }
    before = {name: getattr(jax.config, name) for name in options}
    for chosen in (options, before):
        compilation_cache.reset_cache()
        for name, value in chosen.items():
            jax.config.update(name, value)
        if chosen is options:
            yield


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    folder = built_in(tmp_path_factory.mktemp("data") / "scene", num_views=9, size=(48, 40))
    write_image(folder / "masks/003.png", MASK)
    return folder


@pytest.fixture(scope="module")
def run(scene, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "whole"
    told = []

    def observe(progress):
        newest = runs.latest_checkpoint(folder)
        assert newest is None or newest[0] < progress.step, "told before the checkpoint is written"
        told.append(progress.step)

    summary = pipeline.train(scene, folder, config.parse(Settings, SETTINGS), observe=observe)
    assert told == list(range(1, 31))
    assert summary["steps"] == 30
    assert summary["views"] == 2
    return folder


def test_a_run_folder_holds_what_was_asked_and_what_came_of_it(run, scene):
    manifest = runs.read_json(run / "manifest.json")
    assert manifest["status"] == "done"
    assert Path(manifest["scene"]) == scene.resolve()
    assert {"config.json", "metrics.jsonl", "gaussians.ply", "cameras.json", "normals/001.png"} <= set(
        manifest["files"]
    )
    masks = [record["mask"] for record in runs.read_json(run / "cameras.json")]
    assert [path for path in masks if path] == [masks[3]] == ["masks/0003.png"]
    np.testing.assert_array_equal(read_mask(run / masks[3]), MASK)
    steps = [record["step"] for record in runs.read_metrics(run)]
    assert steps == [5, 10, 15, 20, 25, 30]
    assert runs.read_metrics(run)[2]["held_out_psnr"] > 5
    compiled = [one["program"] for record in runs.read_metrics(run) for one in record.get("compiled", [])]
    assert compiled.count("train_step") == 3, "one program a phase"
    gaussians = read_gaussians(run / "gaussians.ply")
    assert gaussians.num_gaussians == manifest["gaussians"] <= SETTINGS["max_gaussians"]
    assert manifest["photos"] == "9 photos at 48x40, 30 steps"


def test_a_report_is_left_and_a_run_that_kept_no_pictures_is_rendered_for_it(run, scene, tmp_path):
    kept = {file.name: read_image(file)[0].astype(float) for file in (run / "pictures").iterdir()}
    assert sorted(kept) == [
        f"{view}_{kind}.jpg" for view in ("0000", "0008") for kind in ("normals", "photo", "render")
    ]
    photo, other = (read_image(scene / "images" / name)[0] for name in ("000.png", "008.png"))
    # JPEG leaves 5 of 255 in a picture of 48 pixels; the other view is far from that.
    assert np.abs(kept["0000_photo.jpg"] - photo).mean() < 8 < np.abs(kept["0000_photo.jpg"] - other).mean() / 3
    assert (run / "report.html").read_text().count("data:image/jpeg") == 6

    shutil.copytree(run, tmp_path / "run", ignore=shutil.ignore_patterns("pictures"))
    pipeline.report(tmp_path / "run")
    for name, image in kept.items():
        assert np.abs(read_image(tmp_path / "run/pictures" / name)[0] - image).mean() < 1, name


def train_until_killed(step, scene, folder, settings):
    journals = pipeline.train.__globals__["TrainingJournal"]
    note = journals.note

    def killed(journal, progress):
        note(journal, progress)
        if progress.step == step:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(journals, "note", killed)
        pipeline.train(scene, folder, settings, resume=folder.exists())


@pytest.mark.parametrize("stopped_at", [10, 23])
def test_a_run_that_is_killed_goes_on_to_the_same_bits(run, scene, tmp_path, stopped_at):
    settings = config.parse(Settings, SETTINGS)
    folder = tmp_path / "run"
    train_until_killed(stopped_at, scene, folder, settings)
    pipeline.train(scene, folder, settings, resume=True)

    assert (folder / "gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    for file in (run / "normals").iterdir():
        assert (folder / "normals" / file.name).read_bytes() == file.read_bytes()
    without_time = [
        [{k: v for k, v in record.items() if k not in ("seconds", "compiled")} for record in runs.read_metrics(one)]
        for one in (folder, run)
    ]
    assert without_time[0] == without_time[1]


def test_a_run_that_begins_in_another_ends_with_the_same_bits(run, scene, tmp_path):
    begun, whole = tmp_path / "begun", tmp_path / "whole"
    first = {**SETTINGS, "phases": SETTINGS["phases"][:1], "rates": {"decay_steps": 30}}
    pipeline.train(scene, begun, config.parse(Settings, first))
    pipeline.train(scene, whole, config.parse(Settings, SETTINGS), earlier=begun)
    assert (whole / "gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    assert [record["step"] for record in runs.read_metrics(whole)] == [5, 10, 12, 15, 20, 25, 30]
    shutil.rmtree(begun / "checkpoints")
    with pytest.raises(InputError, match="begun: has no checkpoint to begin from"):
        pipeline.train(scene, tmp_path / "none", config.parse(Settings, SETTINGS), earlier=begun)
    assert not (tmp_path / "none").exists()


def test_a_run_with_effects_tells_of_them_and_goes_on_to_the_same_bits(run, scene, tmp_path, monkeypatch):
    """Its photos are clean: `auto` takes nothing in and ends with the bits of a run that was not asked."""
    short = {"phases": [{"name": "vanilla", "steps": 16, "density_control": True}]}
    settings = config.parse(Settings, {**SETTINGS, **short, "effects": "exposure,vignetting,poses,background"})
    whole, stopped, auto = (tmp_path / name for name in ("whole", "stopped", "auto"))
    summary = pipeline.train(scene, whole, settings)
    train_until_killed(9, scene, stopped, settings)
    with monkeypatch.context() as patched:
        patched.setitem(
            pipeline.train.__globals__, "score_images", lambda *_, **__: {"psnr": 0}
        )  # The other is scored.
        pipeline.train(scene, stopped, settings, resume=True)
    for file in ("gaussians.ply", "effects.json", "poses.json", "cameras.json", "background.json"):
        assert (stopped / file).read_bytes() == (whole / file).read_bytes()

    manifest = runs.read_json(whole / "manifest.json")
    assert manifest["effects"]["simulated"] == ["exposure", "vignetting", "poses", "background"]
    assert manifest["effects"]["evidence"]["exposure"]["threshold"] == 0.05
    scores = {f"{name}{way}" for name in ("psnr", "ssim") for way in ("", "_track_gains", "_fitted")}
    aligned = {f"{name}_aligned" for name in scores}
    assert scores | aligned <= summary.keys()
    assert summary["psnr_fitted"] > summary["psnr"]
    assert summary["psnr_track_gains_aligned"] >= summary["psnr_track_gains"]
    assert manifest["cameras"].startswith("cameras turned by ")
    evaluated = pipeline.evaluate(whole)
    assert {name: evaluated[name] for name in scores} == pytest.approx(
        {name: summary[name] for name in scores}, abs=1e-3
    )
    photos = runs.read_json(whole / "effects.json")["photos"]
    records = runs.read_json(whole / "cameras.json")
    held_out = {record["name"] for record in records if record["held_out"]}
    gains = np.array([photo["log_gains"] for name, photo in photos.items() if name not in held_out])
    assert gains.shape == (7, 3)
    np.testing.assert_allclose(gains.mean(0), 0, atol=1e-6)

    # Later stages see the cameras that training moved; those that are held out are where they were.
    given = {record["name"]: np.array(record["viewmat"]) for record in runs.read_json(run / "cameras.json")}
    for frame, record in zip(scene_of_run(whole).frames, records, strict=True):
        np.testing.assert_array_equal(frame.viewmat, np.float32(record["viewmat"]))
        np.testing.assert_array_equal(frame.K, np.float32(record["K"]))
        off = np.abs(given[frame.name] - record["viewmat"]).max()
        assert off == 0 if frame.held_out else 1e-6 < off < 0.05, frame.name

    assert open_result(whole).background.shape == (1, 3), "the built-in scene stands before one white"
    three = pipeline.evaluate(run, three_ways=True)
    assert scores <= three.keys() and not aligned & three.keys()
    assert three["psnr"] == pytest.approx(runs.read_json(run / "manifest.json")["psnr"], abs=1e-3)

    pipeline.train(scene, auto, config.parse(Settings, {**SETTINGS, "effects": "auto"}))
    assert runs.read_json(auto / "manifest.json")["effects"]["simulated"] == []
    assert (auto / "gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    assert not any((auto / name).exists() for name in ("effects.json", "poses.json", "background.json"))
    stored = [set(load_arrays(runs.latest_checkpoint(folder)[1])) for folder in (run, auto, whole)]
    assert stored[0] == stored[1] == {name for name in stored[2] if "effects" not in name} < stored[2]


def test_a_run_goes_on_with_fewer_harmonics_and_they_are_nowhere(run, scene, tmp_path, monkeypatch):
    """Stopped where they are tried again, and where not: it ends with the bits of the run that was not stopped."""
    settings = config.parse(Settings, {**SETTINGS, "effects": "sh_degree"})
    with monkeypatch.context() as patched:
        patched.setattr(harmonics, "smallest", max)  # Where all are needed, that they were tried leaves no trace.
        pipeline.train(scene, tmp_path / "all", settings)
    assert (tmp_path / "all/gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    monkeypatch.setattr(harmonics, "smallest", min)
    whole = tmp_path / "whole"
    pipeline.train(scene, whole, settings)
    found = runs.read_json(whole / "manifest.json")["harmonics"]
    assert found["degree"] == 0
    assert list(found["psnr"]) == ["0", "1"] and all(psnr > 5 for psnr in found["psnr"].values())
    stopped = tmp_path / "stopped"
    for stop in (13, 16):  # Checkpoints are of steps 7 and 14, harmonics are tried after 12.
        train_until_killed(stop, scene, stopped, settings)
    pipeline.train(scene, stopped, settings, resume=True)
    assert (stopped / "gaussians.ply").read_bytes() == (whole / "gaussians.ply").read_bytes()
    assert read_gaussians(whole / "gaussians.ply").sh_degree == 0
    arrays = load_arrays(runs.latest_checkpoint(whole)[1])
    rests = [array for name, array in arrays.items() if name.endswith("sh_rest")]
    assert len(rests) == 3 and not any(array.size for array in rests), "Gaussians and two moments"
    assert b"f_rest" not in (whole / "gaussians.ply").read_bytes()[:2000]
    assert b"f_rest" in (run / "gaussians.ply").read_bytes()[:2000]
    growing = {**SETTINGS, "phases": SETTINGS["phases"][:1], "effects": "sh_degree"}
    with pytest.raises(InputError, match="no phase comes after those of density control"):
        pipeline.train(scene, tmp_path / "growing", config.parse(Settings, growing))


def test_a_benchmark_folder_with_reduced_photos_only_trains_and_scores_the_same(run, scene, tmp_path):
    """The model at four times the size, its names those of the full photos: the same cameras, so the same bits."""
    model = pycolmap.Reconstruction(scene / "sparse/0")
    camera = model.cameras[1]
    camera.width, camera.height, camera.params = 4 * camera.width, 4 * camera.height, 4 * np.asarray(camera.params)
    for image in model.images.values():
        image.name = image.name.replace(".png", ".JPG")
    (tmp_path / "scene/sparse/0").mkdir(parents=True)
    model.write_binary(tmp_path / "scene/sparse/0")
    shutil.copytree(scene / "images", tmp_path / "scene/images_4")
    shutil.copytree(scene / "masks", tmp_path / "scene/masks")

    summary = pipeline.train(tmp_path / "scene", tmp_path / "run", config.parse(Settings, SETTINGS))

    assert (tmp_path / "run/gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    assert summary["psnr"] == runs.read_json(run / "manifest.json")["psnr"]
    assert pipeline.evaluate(tmp_path / "run")["psnr"] == pytest.approx(summary["psnr"], abs=1e-3)
    with pytest.raises(InputError, match=r"run: was started on .*/scene, not on .*; a resumed run keeps its data set"):
        pipeline.train(scene, tmp_path / "run", config.parse(Settings, SETTINGS), resume=True)


def test_a_run_that_holds_nothing_out_is_meshed_and_measured_but_not_scored(scene, tmp_path):
    """On the photos that the other runs train on: their programs, compiled once."""
    model = pycolmap.Reconstruction(scene / "sparse/0")
    for image in [image for image in model.images.values() if image.name in ("000.png", "008.png")]:
        model.deregister_frame(image.frame_id)
    (tmp_path / "scene/sparse/0").mkdir(parents=True)
    model.write_binary(tmp_path / "scene/sparse/0")
    shutil.copy(scene / "gt_points.npz", tmp_path / "scene")
    settings = config.parse(Settings, {**SETTINGS, "hold_out": "none", "images": str(scene / "images")})

    summary = pipeline.train(tmp_path / "scene", tmp_path / "run", settings)

    assert (summary["psnr"], summary["ssim"], summary["views"], summary["steps"]) == (None, None, 0, 30)
    cameras = runs.read_json(tmp_path / "run/cameras.json")
    assert len(cameras) == 7 and not any(camera["held_out"] for camera in cameras)
    assert not any("held_out_psnr" in record for record in runs.read_metrics(tmp_path / "run"))
    figures = pipeline.evaluate(tmp_path / "run", mesh=scene / "gt_mesh.ply")
    assert (figures["psnr"], figures["views"]) == (None, 0)
    assert figures["chamfer"] < 0.02, "the true mesh"
    assert figures["distances"] == "point to point" and "floor" not in figures, (
        "its triangles are not beside the points"
    )
    with pytest.raises(InputError, match="run: has no held-out views to render"):
        pipeline.render(tmp_path / "run", tmp_path / "pictures", which="held_out")


def test_a_run_is_scored_on_its_own_split_whatever_became_of_the_list(run, scene, tmp_path):
    shutil.copytree(run, tmp_path / "run")
    config_file = tmp_path / "run/config.json"
    runs.write_json(config_file, {**runs.read_json(config_file), "hold_out": str(tmp_path / "gone.txt")})
    held_out = [record["name"] for record in runs.read_json(run / "cameras.json") if record["held_out"]]
    assert [frame.name for frame in scene_of_run(tmp_path / "run").held_out_frames] == held_out != []


@pytest.mark.parametrize("fault", ["hold-out", "mask", "normals", "images"])
def test_data_that_do_not_fit_are_one_line_and_leave_no_run(scene, tmp_path, capsys, fault):
    options = {"hold-out": ["--hold-out", str(tmp_path / "list.txt")], "normals": ["--normals", str(tmp_path / "maps")]}
    shutil.copytree(scene, tmp_path / "scene", ignore=shutil.ignore_patterns("depth", "normals", "gt_*"))
    (tmp_path / "list.txt").write_text("004.jpg")
    for folder, names in (("maps", [f"{i:03d}.png" for i in range(9)]), ("scene/masks", ["004.png"])):
        for name in names if fault != "hold-out" else []:
            write_image(tmp_path / folder / name, np.full((40, 40, 3), 9, np.uint8))
    if fault == "images":
        shutil.move(tmp_path / "maps/004.png", tmp_path / "scene/images/004.png")
    if fault != "mask":
        shutil.rmtree(tmp_path / "scene/masks", ignore_errors=True)
    told = {
        "hold-out": "list.txt, line 1: there is no photo 004.jpg; the nearest name is 004.png",
        "mask": "masks/004.png: mask is 40x40 but its image 48x40",
        "normals": "maps/001.png: normal map is 40x40, its frame 48x40",
        "images": "images/004.png: image is 40x40 but its camera says 48x40",
    }
    assert cli.main(["train", str(tmp_path / "scene"), "--out", str(tmp_path / "run"), *options.get(fault, [])]) == 2
    *progress, error = capsys.readouterr().err.splitlines()
    assert error.startswith("gsjax: error: ") and error.endswith(told[fault])
    assert not any("Error" in line for line in progress)
    assert not (tmp_path / "run").exists()


def test_gaussians_are_meshed_from_a_scenes_cameras_without_its_pixels(run, scene, tmp_path):
    shutil.copytree(scene / "sparse", tmp_path / "scene/sparse")
    (tmp_path / "scene/images").mkdir()
    for photo in (scene / "images").iterdir():
        (tmp_path / "scene/images" / photo.name).write_bytes(photo.read_bytes()[:100])  # the header, and no more
    result = open_result(run / "gaussians.ply", scene=tmp_path / "scene")
    assert result.names == open_result(run).names and result.held_out == open_result(run).held_out


def test_a_checkpoint_that_finds_no_room_ends_the_run_in_one_line(scene, tmp_path, monkeypatch):
    def full(path, tree):
        raise InputError(f"cannot write {path}: No space left on device")

    monkeypatch.setattr(runs.checkpoints, "save", full)
    with pytest.raises(InputError, match="step_0000007.npz: No space left on device"):
        pipeline.train(scene, tmp_path / "run", config.parse(Settings, SETTINGS))
    assert len(runs.read_metrics(tmp_path / "run")) == 1, "what was logged before stays"


def test_vanilla_is_the_same_run_without_its_terms(scene, tmp_path):
    folder = tmp_path / "run"
    pipeline.train(scene, folder, config.parse(Settings, {**SETTINGS, "vanilla": True}))
    terms = [set(record["terms"]) for record in runs.read_metrics(folder)]
    assert terms == [{"l1", "dssim"}] * 6
    assert not (folder / "normals").exists()


def test_the_mesh_lies_on_the_scene_and_is_scored_with_the_images(run, scene, tmp_path):
    report = pipeline.mesh(run, tmp_path / "mesh.ply", level=0.1, points=5000)
    mesh = read_mesh(tmp_path / "mesh.ply")
    assert len(mesh.faces) == report["faces"] > 100
    assert report["settled"]["after"] < report["settled"]["before"] and report["settled"]["seen_share"] > 0.5
    # Fewer than thirty steps on photos of forty pixels: near the surface, not on it.
    figures = pipeline.evaluate(run, mesh=tmp_path / "mesh.ply", lpips=[small_lpips(tmp_path / "vgg.onnx")[0]])
    json.dumps(figures)
    assert 0 < figures["lpips_vgg"] != figures["lpips_vgg_3dgs"] > 0
    assert figures["floor"]["chamfer"] < 5e-4 < figures["chamfer"] < 0.2
    assert figures["distances"] == "point to surface"
    assert 5 < figures["normal_error_deg"] < 90
    assert figures["psnr"] == pytest.approx(runs.read_json(run / "manifest.json")["psnr"], abs=1e-3)
    assert 0 < figures["ssim"] < 1


def test_a_mesh_whose_photos_have_gone_is_made_as_the_gaussians_have_it(run, tmp_path, capsys):
    moved = shutil.copytree(run, tmp_path / "run")
    runs.write_json(moved / "manifest.json", {**runs.read_json(run / "manifest.json"), "scene": str(tmp_path / "gone")})
    options = {"level": 0.1, "points": 5000}
    report = pipeline.mesh(moved, tmp_path / "mesh.ply", **options)
    assert report["settled"] is None
    assert f"mesh: did not settle on its photos: {tmp_path / 'gone'}: no such folder" in capsys.readouterr().err
    assert pipeline.mesh(run, tmp_path / "asked.ply", settled=False, **options) == report
    assert (tmp_path / "asked.ply").read_bytes() == (tmp_path / "mesh.ply").read_bytes()


def test_the_true_mesh_is_its_own_floor(run, scene):
    figures = pipeline.evaluate(run, mesh=scene / "gt_mesh.ply")
    assert figures["lpips_vgg_3dgs"] is None and "lpips_vgg" not in figures, "without weights"
    floor = figures["floor"]
    assert floor == {name: figures[name] for name in floor}
    assert max(floor["accuracy"], floor["completeness"], floor["chamfer"]) < 5e-4
    assert floor["fscore"] == 1.0 and floor["outward_share"] > 0.999
    # Differences of depth over two pixels see the truth's own curves and edges.
    assert floor["mesh_normal_error_median_deg"] < 8 and floor["mesh_depth_error"] < 5e-3
    assert floor["mesh_normal_error_deg"] < 0.5 * figures["normal_error_deg"]


def test_a_run_is_scored_at_other_sizes_of_its_photos(run):
    figures = pipeline.evaluate(run, mesh=Path(scene_of_run(run).root) / "gt_mesh.ply", zooms=[1, 0.5])
    assert figures["psnr_zoom_1"] == figures["psnr"] and figures["ssim_zoom_1"] == figures["ssim"]
    assert 5 < figures["psnr_zoom_0.5"] != figures["psnr"]
    whole, half = scene_of_run(run), scene_of_run(run, zoom=0.5)
    for frame, smaller in zip(whole.frames, half.frames, strict=True):
        assert (frame.name, frame.held_out) == (smaller.name, smaller.held_out)
        np.testing.assert_allclose(smaller.K[:2], frame.K[:2] / 2, rtol=1e-6)
        boxes = frame.pixels().image.astype(float).reshape(20, 2, 24, 2, 3).mean((1, 3))
        np.testing.assert_allclose(smaller.pixels().image, boxes, atol=0.51)


@pytest.mark.parametrize(
    ("zoom", "fault"), [(2, "on photos as they are; there are none 2 times larger"), (0, "must be a number above 0")]
)
def test_a_zoom_that_photos_do_not_allow_is_one_line(run, zoom, fault, capsys):
    assert cli.main(["eval", str(run), "--zoom", str(zoom)]) == 2
    message = capsys.readouterr().err
    assert fault in message and message.count("\n") == 1


def test_pictures_have_the_size_of_their_views(run, tmp_path):
    pipeline.render(run, tmp_path / "held_out", which="held_out")
    files = sorted((tmp_path / "held_out").iterdir())
    assert [f.name for f in files[:3]] == ["000_color.png", "000_depth.png", "000_normal.png"]
    assert len(files) == 6
    assert all(image_size(f) == (48, 40) for f in files)
    photo, _ = read_image(Path(runs.read_json(run / "manifest.json")["scene"]) / "images/000.png")
    rendered, _ = read_image(files[0])
    assert np.abs(photo.astype(float) - rendered).mean() < 60, "the same view, roughly"


def test_a_bare_file_of_gaussians_is_meshed_from_cameras_around_it(run, tmp_path, monkeypatch):
    monkeypatch.setattr(viewpoints, "SIZE", 64)
    monkeypatch.setattr(viewpoints, "COUNT", 16)
    report = pipeline.mesh(run / "gaussians.ply", tmp_path / "mesh.glb", level=0.1, points=3000)
    assert report["faces"] > 0
    assert (tmp_path / "mesh.glb").exists()


def test_a_folder_without_gaussians_is_no_run(tmp_path):
    with pytest.raises(InputError, match="holds no gaussians.ply; it is no run folder"):
        pipeline.mesh(tmp_path, tmp_path / "mesh.ply")
