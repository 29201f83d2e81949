"""`gsjax masks`, with graphs of known function: what is red in a photo is a person, what is blue is sky."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from small_graphs import ANY, NHWC, SmallGraph
from tqdm import tqdm

from gsjax import cli, pipeline
from gsjax.errors import InputError
from gsjax.io.sfm import features
from gsjax.io.sfm.source_photos import list_source_photos
from gsjax.networks.records import MASK_NETWORKS

WIDTH, HEIGHT = 60, 40
CLASSES = ("person", "tree", "sky")  # What a pixel's strongest channel says.
RECORD = {
    "licence": "none",
    "size": {"rule": "multiple", "multiple": 4},
    "kind": "scores",
    "output": {"place": 0},
    "classes": CLASSES,
}


@pytest.fixture(autouse=True)
def silent(monkeypatch):
    monkeypatch.setitem(pipeline.masks.__globals__, "tqdm", partial(tqdm, disable=True))
    monkeypatch.setattr(cli.environment, "prepare", lambda: None)


def scenery(width=WIDTH, height=HEIGHT) -> np.ndarray:
    """Sky above, a person at the lower left, trees elsewhere."""
    colors = np.zeros((height, width, 3), np.uint8)
    colors[..., 1] = 200
    colors[: height // 4] = 0, 0, 200
    colors[height // 2 :, : width // 3] = 200, 0, 0
    return colors


def is_person(colors):
    return colors[..., 0] > 100


def write_photos(root: Path, **orientations) -> Path:
    """Photos whose upright picture is `scenery`, stored as the EXIF orientation of each has it."""
    root.mkdir()
    for name, turn in {"a": 1, "b": 1, **orientations}.items():
        stored = {1: np.asarray, 6: np.rot90, 8: partial(np.rot90, k=3), 2: np.fliplr}[turn](scenery())
        exif = Image.Exif()
        exif[0x0112] = turn
        Image.fromarray(np.ascontiguousarray(stored)).save(root / f"{name}.png", exif=exif)
    return root


def write_record(file: Path, **changes) -> Path:
    file.write_text(json.dumps({**RECORD, **changes}))
    return file


def graph_of(kind: str, file: Path, *, channels_last=False, half=False) -> Path:
    graph = SmallGraph()
    image = graph.input("image", ANY)
    value = graph.add("AveragePool", image, kernel_shape=[2, 2], strides=[2, 2]) if half else image
    if kind == "labels":
        labels = graph.add("ArgMax", value, axis=1, keepdims=0)
        graph.output(labels, "labels", np.int64)
    elif kind == "probability":
        graph.output(graph.channel(value, 0), "person")
    else:
        graph.output(graph.transposed(value, NHWC) if channels_last else value, "scores")
    return graph.save(file)


def read_mask(file: Path) -> np.ndarray:
    return np.asarray(Image.open(file))


@pytest.mark.parametrize("kind", ["channels last", "half", "labels", "probability"])
def test_what_a_class_covers_is_zero_and_all_else_counts(tmp_path, kind):
    photos = write_photos(tmp_path / "photos")
    name = kind if kind in ("labels", "probability") else "scores"
    classes = ["person"] if kind == "probability" else CLASSES
    record = write_record(tmp_path / "r.json", kind=name, classes=classes)
    weights = graph_of(name, tmp_path / "w.onnx", channels_last=kind == "channels last", half=kind == "half")
    report = pipeline.masks(photos, record, weights, classes=["person"])
    assert (report["masks"], report["photos_without"], report["folder"]) == (2, 0, str(photos / "masks"))
    np.testing.assert_allclose(report["left_out"], 1 / 6)
    mask = read_mask(photos / "masks/a.png.png")
    np.testing.assert_array_equal(mask, np.where(is_person(scenery()), 0, 255))


def test_a_turned_photo_is_shown_upright_and_its_mask_lies_as_the_file_does(tmp_path):
    """The graph finds a person only below the middle of what it is shown."""
    photos = write_photos(tmp_path / "photos", left=6, right=8, mirrored=2)
    graph = SmallGraph()
    image = graph.input("image", (1, 3, HEIGHT, WIDTH))
    below = np.repeat(np.arange(HEIGHT)[:, None] >= HEIGHT / 2, WIDTH, 1)[None]
    graph.output(graph.add("Mul", graph.channel(image, 0), graph.constant(below)), "person")
    record = write_record(tmp_path / "r.json", kind="probability", classes=["person"])
    report = pipeline.masks(photos, record, graph.save(tmp_path / "w.onnx"))
    assert report["photos_without"] == 0
    for shot in list_source_photos(photos):
        stored = np.asarray(Image.open(shot.path))
        np.testing.assert_array_equal(read_mask(shot.mask_path), np.where(is_person(stored), 0, 255))
        np.testing.assert_array_equal(shot.upright(shot.read_mask()), np.where(is_person(scenery()), 0, 255))


def test_sfm_finds_no_features_where_the_mask_is_zero(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (10, 15, 3)).astype(np.uint8)
    large = np.kron(noise, np.ones((12, 12, 1), np.uint8))
    (tmp_path / "masks").mkdir()
    for name in "ab":
        Image.fromarray(large).save(tmp_path / f"{name}.png")
    mask = np.where(np.arange(180) < 90, np.uint8(0), np.uint8(255)) * np.ones((120, 1), np.uint8)
    Image.fromarray(mask).save(tmp_path / "masks/a.png")
    masked, whole = features.find_features(list_source_photos(tmp_path), partial(tqdm, disable=True))
    assert (whole.xy[:, 0] < 88).sum() > 20
    assert len(masked.xy) > 20 and (masked.xy[:, 0] >= 88).all()


@pytest.mark.parametrize("network", MASK_NETWORKS)
def test_every_known_network_is_fed_and_read_as_its_record_says(tmp_path, network, capsys):
    """Graphs of the networks' inputs and outputs: red is what they look for."""
    record = MASK_NETWORKS[network]
    assert record.size.sides is not None
    graph = SmallGraph()
    image = graph.input("x", (1, 3, *record.size.sides))
    if record.kind == "scores":
        red = graph.add("Unsqueeze", graph.channel(image, 0), graph.constant([1], np.int64))  # -1..1
        graph.output(graph.add("Concat", graph.affine(red, -1.0), red, axis=1), "y")
    else:
        colors = graph.affine(image, record.std, record.mean)
        graph.output(graph.add("Unsqueeze", graph.channel(colors, 0), graph.constant([1], np.int64)), "1959")
    photos = write_photos(tmp_path / "photos")
    weights = graph.save(tmp_path / "w.onnx")
    assert cli.main(["masks", str(photos), "--network", network, "--weights", str(weights)]) == 0
    assert f"licence            {record.licence}\n" in capsys.readouterr().out
    wrong = (read_mask(photos / "masks/a.png.png") == 0) != is_person(scenery())
    assert wrong.mean() < 0.02, "only at the border, which the network's size moves"
    assert not wrong[:18].any()


REFUSED = {
    "unknown class": ({}, ["dog"], r"classes=dog: the network knows person, tree, sky"),
    "four classes": ({"classes": [*CLASSES, "car"]}, ["car"], r"gives \[1, 3, 40, 60\], not a score for each of 4"),
    "two of one name": ({"classes": ["sky", "sky"]}, ["sky"], r"r.json: classes=sky, sky are none, or one .* twice"),
    "no such output": ({"output": {"names": ["mask"]}}, ["sky"], r"w.onnx: gives no classes \(mask\); .* scores"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_what_does_not_fit_is_one_line_and_leaves_nothing(tmp_path, fault):
    photos = write_photos(tmp_path / "photos")
    changes, classes, message = REFUSED[fault]
    record, weights = write_record(tmp_path / "r.json", **changes), graph_of("scores", tmp_path / "w.onnx")
    with pytest.raises(InputError, match=message) as caught:
        pipeline.masks(photos, record, weights, classes=classes)
    assert "\n" not in str(caught.value)
    assert sorted(file.name for file in photos.iterdir()) == ["a.png", "b.png"]


def test_masks_that_are_there_are_not_lost(tmp_path):
    photos = write_photos(tmp_path / "photos")
    (photos / "masks").mkdir()
    (photos / "masks/a.png").write_bytes(b"mine")
    with pytest.raises(InputError, match="photos/masks: exists and is not empty"):
        pipeline.masks(photos, "u2net", tmp_path / "w.onnx")
    with pytest.raises(InputError, match="network=mine: neither a known network .pphumanseg, u2net, skyseg. nor"):
        pipeline.masks(photos, "mine", tmp_path / "w.onnx")
    assert (photos / "masks/a.png").read_bytes() == b"mine"
