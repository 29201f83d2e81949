"""`gsjax normals`, with graphs of known function: photos whose colours are the normals of a ball."""

import json
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from small_graphs import ANY, NHWC, SmallGraph, color_network
from small_scenes import angles
from tqdm import tqdm
from transforms_scenes import write_transforms

from gsjax import cli, pipeline
from gsjax.errors import InputError
from gsjax.io import normal_folders
from gsjax.io.normal_maps import normal_maps
from gsjax.io.scenes import load_scene
from gsjax.networks.records import NETWORKS
from gsjax.normals.axes import axis_signs

WIDTH, HEIGHT = 60, 40
RECORD = {
    "licence": "none",
    "size": {"rule": "multiple", "multiple": 4},
    "normals": {"names": ["normal"]},
    "axes": "opencv",
    "range": "signed",
}


@pytest.fixture(autouse=True)
def silent(monkeypatch):
    monkeypatch.setitem(pipeline.normals.__globals__, "tqdm", partial(tqdm, disable=True))
    monkeypatch.setattr(cli.environment, "prepare", lambda: None)


def ball(width=WIDTH, height=HEIGHT):
    """Normals of the front of a ball, `[H, W, 3]`, in our axes; no two photos need differ."""
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, width), np.linspace(-0.6, 0.6, height))
    return np.stack([x, y, -np.sqrt(1 - x * x - y * y)], -1)


def as_photo(normals):
    return np.rint(255 * (normals + 1) / 2).astype(np.uint8)


def write_scene(root: Path, axes="opencv", photos=None, **lens) -> Path:
    """Photos of the ball's normals, in a network's axes."""
    raw = as_photo(ball() * axis_signs(axes))
    photos = {f"images/{name}.png": raw for name in "abc"} if photos is None else photos
    lens = {"fl_x": 55.0, "fl_y": 50.0, "cx": 31.0, "cy": 19.5, "w": WIDTH, "h": HEIGHT, **lens}
    return write_transforms(root, photos, **lens)


def write_record(file: Path, **changes) -> Path:
    file.write_text(json.dumps({**RECORD, **changes}))
    return file


def read(folder, scene):
    return {name: read() for name, read in normal_maps(folder, load_scene(scene).frames).items()}


def contract(network: str, file) -> Path:
    """A graph with the inputs and outputs of a known network."""
    graph = SmallGraph()
    if network == "moge2":
        image = graph.input("image")
        tokens = graph.input("num_tokens", (), np.int64)
        normal = graph.transposed(graph.affine(image, 2.0, -1.0), NHWC)
        graph.output(graph.add("Mul", normal, graph.constant(1.0)), "points")
        graph.output(normal, "normal")
        # A list with the tokens in it cannot be made where they are a list themselves.
        listed = graph.add("Unsqueeze", tokens, graph.constant([0], np.int64))
        listed = graph.add("Concat", listed, graph.constant([9999], np.int64), axis=0)
        one = graph.add("Min", graph.add("ReduceMin", graph.add("Cast", listed, to=1)), graph.constant(1.0))
        graph.output(graph.channel(graph.add("Mul", graph.affine(image, 0.0, 1.0), one), 0), "mask")
        graph.output(graph.channel(image, 1), "scale")
    elif network == "metric3d":
        image = graph.input("pixel_values")
        graph.output(graph.add("ReduceMax", image, axes=[1]), "predicted_depth")
        graph.output(graph.affine(image, 2 / 255, -1.0), "predicted_normal")
        graph.output(graph.add("ReduceMax", graph.affine(image, 0.0, 20.0), axes=[1]), "normal_confidence")
    elif network == "omnidata":
        graph.output(graph.add("Relu", graph.input("input.1", (1, 3, 384, 384))), "1234")
    else:
        image, K = graph.input("img"), graph.input("intrins", (1, 3, 3))
        colors = graph.affine(image, NETWORKS["dsine"].std, NETWORKS["dsine"].mean)
        graph.output(graph.add("Reshape", K, graph.constant([1, 9], np.int64)), "coarse")
        graph.output(graph.affine(colors, 2.0, -1.0), "final")
    return graph.save(file)


@pytest.mark.parametrize("network", NETWORKS)
def test_every_known_network_is_fed_and_read_as_its_contract_says(tmp_path, network, capsys):
    scene = write_scene(tmp_path / "scene", NETWORKS[network].axes)
    weights = contract(network, tmp_path / "weights.onnx")
    assert cli.main(["normals", str(scene), "--network", network, "--weights", str(weights)]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert "maps             3\n" in printed.out
    assert "provider         CPUExecutionProvider\n" in printed.out
    assert f"licence          {NETWORKS[network].licence}\n" in printed.out
    maps = read(scene / f"normals_{network}", scene)
    assert sorted(maps) == ["a.png", "b.png", "c.png"]
    for normals in maps.values():
        # 8-bit colours are off by up to 0.4 degrees, resampling to the network's size and back by the rest.
        assert angles(normals, ball()).max() < 1.5
        assert angles(normals, ball()).mean() < 0.3


@pytest.mark.parametrize(
    ("shape", "dtype", "changes"),
    [
        (ANY, np.float16, {}),
        ((1, "h", "w", "c"), np.float32, {"layout": "NHWC"}),
        ((1, 3, 28, 70), np.float32, {}),
        ((1, 3, 64, 64), np.float32, {"size": {"rule": "fixed", "sides": [384, 384], "border": "reflect"}}),
        (ANY, np.float32, {"size": {"rule": "multiple", "multiple": 7, "longest": 90, "border": [255, 0, 9]}}),
        (ANY, np.float32, {"axes": "+x-y-z", "normals": {"place": 0}}),
    ],
)
def test_a_record_of_ones_own_in_any_layout_size_and_precision(tmp_path, shape, dtype, changes):
    record = write_record(tmp_path / "mine.json", **changes)
    scene = write_scene(tmp_path / "scene", changes.get("axes", "opencv"))
    weights = color_network(tmp_path / "w.onnx", shape=shape, dtype=dtype)
    report = pipeline.normals(scene, record, weights)
    assert report["folder"] == str(scene / "normals_mine")
    for normals in read(report["folder"], scene).values():
        assert angles(normals, ball()).mean() < (1.5 if 28 in shape or 64 in shape else 0.8)


def test_what_the_network_rejects_is_exactly_zero_and_may_be_anything(tmp_path):
    photo = as_photo(ball())
    photo[:, :20] = 255  # Rejected below, where every component would be infinite.
    scene = write_scene(tmp_path / "scene", photos={f"images/{n}.png": photo for n in "ab"})
    graph = SmallGraph()
    image, one = graph.input("image"), graph.constant(1.0)
    white = graph.add("Greater", graph.add("ReduceMin", image, axes=[1]), graph.constant(0.99))
    rejected = graph.add("Cast", white, to=1)
    infinite = graph.add("Div", rejected, graph.add("Sub", one, rejected))
    graph.output(graph.add("Add", graph.affine(image, 2.0, -1.0), infinite), "normal")
    graph.output(graph.add("Sub", graph.constant(3.0), rejected), "sure")  # Kappa 3 or 2: 34 or 46 degrees.
    confidence = {"names": ["sure"], "kind": "kappa", "bound": 40}
    record = write_record(tmp_path / "r.json", confidence=confidence)
    pipeline.normals(scene, record, graph.save(tmp_path / "w.onnx"), tmp_path / "maps")
    for file in (tmp_path / "maps").glob("*.npz"):
        stored = np.load(file)["cam"]
        assert stored.dtype == np.float16 and (stored[:, :20] == 0).all()
        assert angles(stored[:, 20:], ball()[:, 20:]).max() < 0.6


def test_a_lens_is_taken_out_before_the_network_sees_it_and_not_once_more(tmp_path):
    """This lens leaves the frame as large as the photo: the size alone would make it the photo's map."""
    scene = write_scene(tmp_path / "scene", k1=-0.2)
    frame = load_scene(scene).frames[0]
    assert frame.origin is not None and frame.origin.photo == frame.origin.undistorted
    pipeline.normals(scene, write_record(tmp_path / "r.json"), color_network(tmp_path / "w.onnx"), tmp_path / "maps")
    expected = frame.pixels().image.astype(np.float64) * 2 / 255 - 1
    valid = frame.pixels().valid
    is_valid = np.ones(expected.shape[:2], bool) if valid is None else valid > 127
    assert angles(read(tmp_path / "maps", scene)[frame.name][is_valid], expected[is_valid]).max() < 0.1


def test_intrinsics_follow_the_photo_and_the_networks_pixel_centres(tmp_path):
    """The graph gives K's first row as the normal, everywhere."""
    graph = SmallGraph()
    image, K = graph.input("img", (1, 3, 80, 160)), graph.input("K", (1, 3, 3))
    row = graph.add("Gather", K, graph.constant([0], np.int64), axis=1)
    row = graph.add("Reshape", row, graph.constant([1, 3, 1, 1], np.int64))
    graph.output(graph.add("Add", graph.affine(image, 0.0), row), "normal")
    scene = write_scene(tmp_path / "scene")
    record = write_record(tmp_path / "r.json", extra={"intrinsics": "intrinsics"}, pixel_center=0)
    pipeline.normals(scene, record, graph.save(tmp_path / "w.onnx"), tmp_path / "maps")
    # 60x40 at twice the size is 120x80, with 20 columns on either side.
    expected = np.array([2 * 55.0, 0, 2 * 31.0 + 20 - 0.5])
    for normals in read(tmp_path / "maps", scene).values():
        assert angles(normals, expected).max() < 0.03


def test_a_second_run_makes_what_is_missing_and_a_killed_one_leaves_whole_maps(tmp_path, monkeypatch):
    scene, weights = write_scene(tmp_path / "scene"), color_network(tmp_path / "w.onnx")
    run = partial(pipeline.normals, scene, write_record(tmp_path / "r.json"), weights, tmp_path / "maps")

    def killed(array, *args, **more):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(np, "savez_compressed", killed)
        with pytest.raises(KeyboardInterrupt):
            run()
    assert not list((tmp_path / "maps").rglob("*.npz")) and not list((tmp_path / "maps").rglob(".*"))
    assert run()["made"] == 3, "goes on in the folder of the killed run"
    report = run()
    assert (report["made"], report["maps"], report["seconds_per_map"]) == (0, 3, None)
    (tmp_path / "maps/b.npz").unlink()
    assert run()["made"] == 1
    assert sorted(read(tmp_path / "maps", scene)) == ["a.png", "b.png", "c.png"]


def test_maps_of_another_model_or_origin_are_never_overwritten(tmp_path):
    scene, maps = write_scene(tmp_path / "scene"), tmp_path / "maps"
    record, weights = write_record(tmp_path / "r.json"), color_network(tmp_path / "w.onnx")
    pipeline.normals(scene, record, weights, maps)
    before = {f: f.read_bytes() for f in maps.rglob("*.*")}
    other = color_network(tmp_path / "other.onnx", gain=1.0)
    with pytest.raises(InputError, match=r"maps: its maps were made with sha256 = \w{12}, not \w{12}; choose another"):
        pipeline.normals(scene, record, other, maps)
    with pytest.raises(InputError, match=r'made with record.axes = "opencv", not "dsine"'):
        pipeline.normals(scene, write_record(tmp_path / "r.json", axes="dsine"), weights, maps)
    write_record(tmp_path / "r.json")
    write_scene(scene, fl_x=70.0)
    with pytest.raises(InputError, match="the camera of a.png has changed since its map was made"):
        pipeline.normals(scene, tmp_path / "r.json", weights, maps)
    assert before == {f: f.read_bytes() for f in maps.rglob("*.*")}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/a.npy").write_bytes(b"")
    with pytest.raises(InputError, match="mine: holds files that gsjax normals did not make"):
        pipeline.normals(scene, tmp_path / "r.json", weights, tmp_path / "mine")
    assert os.listdir(tmp_path / "mine") == ["a.npy"]


def signed(graph):
    return graph.affine(graph.input("image"), 2.0, -1.0)


GRAPHS = {
    "grey": lambda graph: graph.input("image", ("b", 1, "h", "w")),
    "turned": lambda graph: graph.transposed(signed(graph), [0, 1, 3, 2]),
    "nan": lambda graph: graph.add("Div", signed(graph), graph.constant(0.0)),
    "does not run": lambda graph: graph.add("Add", signed(graph), graph.constant(np.zeros((1, 3, 7, 5)))),
}
FAULTS = {
    "grey": r"w.onnx: takes no picture of three channels; its inputs are image \[\?, 1, \?, \?\]",
    "turned": r"w.onnx: gives \[1, 3, 60, 40\] for a photo of 60x40, not normals, three values a pixel",
    "nan": r"w.onnx: gives 2400 pixels that are not finite for a.png",
    "does not run": r"w.onnx: does not run on image \[1, 3, 40, 60\] \(.*\)",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_graph_with_a_fault_is_one_line_and_leaves_nothing(tmp_path, fault, capfd):
    scene, record, graph = write_scene(tmp_path / "scene"), write_record(tmp_path / "r.json"), SmallGraph()
    graph.output(GRAPHS[fault](graph), "normal")
    weights = graph.save(tmp_path / "w.onnx")
    out = tmp_path / "new/maps"
    code = cli.main(["normals", str(scene), "--network", str(record), "--weights", str(weights), "--out", str(out)])
    assert code == 2
    error = capfd.readouterr().err
    assert error.startswith("gsjax: error: ") and error.count("\n") == 1
    with pytest.raises(InputError, match=FAULTS[fault]):
        pipeline.normals(scene, record, weights, out)
    assert not (tmp_path / "new").exists()


def test_files_that_cannot_serve_are_named(tmp_path):
    scene, record = write_scene(tmp_path / "scene"), write_record(tmp_path / "r.json")
    weights = color_network(tmp_path / "w.onnx")
    (tmp_path / "text.onnx").write_text("no graph")
    write_record(tmp_path / "a.json", axis="opencv")
    write_record(tmp_path / "b.json", size={"rule": "multiple", "multiple": 0})
    unknown = r"network=marigold: neither a known network \(moge2, .*, midas, depth_anything_v2\) nor a file"
    for message, data, network, graph in (
        ("nowhere.onnx: no such file of weights", scene, record, tmp_path / "nowhere.onnx"),
        (r"text.onnx: no ONNX graph that onnxruntime [\d.]+ loads", scene, record, tmp_path / "text.onnx"),
        ("nowhere: no such folder", tmp_path / "nowhere", record, weights),
        (unknown, scene, "marigold", weights),
        ("a.json: unknown key 'axis'; the nearest known one is 'axes'", scene, tmp_path / "a.json", weights),
        ("b.json: size: multiple=0 is below 1", scene, tmp_path / "b.json", weights),
    ):
        with pytest.raises(InputError, match=message) as error:
            pipeline.normals(data, network, graph, tmp_path / "maps")
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="cannot write .*w.onnx/maps: Not a directory"):
        pipeline.normals(scene, record, weights, weights / "maps")
    photo = scene / "images/b.png"
    photo.write_bytes(photo.read_bytes()[:300])
    pipeline.normals(scene, record, weights, tmp_path / "maps")
    assert sorted(p.name for p in (tmp_path / "maps").rglob("*.npz")) == ["a.npz", "c.npz"], "a bad photo is left out"


def test_training_finds_maps_by_the_networks_name(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "scene")
    with pytest.raises(InputError, match=r"normals: .*scene holds none; name one, or make one with gsjax normals"):
        normal_folders.find(scene, "auto")
    pipeline.normals(scene, write_record(tmp_path / "r.json"), color_network(tmp_path / "w.onnx"))
    folder = str(scene / "normals_r")
    assert [normal_folders.find(scene, name) for name in ("r", "normals_r", "auto", folder)] == [folder] * 4
    assert normal_folders.find(scene, "elsewhere") == "elsewhere"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r").mkdir()
    assert normal_folders.find(scene, "r") == "r", "a folder that is there is what was meant"
    pipeline.normals(scene, tmp_path / "r.json", tmp_path / "w.onnx", scene / "others")
    with pytest.raises(InputError, match="scene holds normals_r, others; name one"):
        normal_folders.find(scene, "auto")
