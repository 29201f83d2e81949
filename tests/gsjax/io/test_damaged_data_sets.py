"""Damaged data sets: whatever their files hold, they load or the fault is one line; `GSJAX_FUZZ=50000` tries more."""

import zipfile

import cv2
import numpy as np
import pycolmap
import pytest
from fuzzing import fuzz_files
from PIL import Image
from transforms_ring import edit, ring, write

from gsjax.errors import InputError
from gsjax.io.arrays import headers, read_arrays
from gsjax.io.images import image_size, read_image, read_mask
from gsjax.io.normal_maps import normal_maps
from gsjax.io.scenes import load_scene
from gsjax.io.truth import load_truth


def read_all(root):
    """Everything of a scene that reading may bring up: frames, their pixels, tracks."""
    scene = load_scene(root)
    for frame in scene.frames[:2]:
        frame.pixels()
    if scene.tracks is not None:
        scene.tracks()


def stated(root):
    """Writes a `transforms.json` with as much in it as there may be; returns the file."""
    names = [f"images/{i:03d}.png" for i in range(3)]
    camera = {"w": 40, "h": 30, "fl_x": 40.0, "fl_y": 41.0, "cx": 20.0, "cy": 15.0, "k1": 0.01, "camera_angle_x": 0.8}
    lists = {"train_filenames": names[:2], "test_filenames": names[2:], "test_frames": []}
    write(root, poses=ring(3), **camera, **lists, camera_model="OPENCV", ply_file_path="p.ply")
    edit(root, lambda m: m["frames"][1].update(fl_x=45.0, k1=0.02, is_bad=False, mask_path=names[1]))
    columns = "float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"
    head = "".join(f"property {column}\n" for column in columns)
    rows = "1 2 3 10 20 30\n4 5 6 40 50 60\n"
    (root / "p.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 2\n{head}end_header\n{rows}")
    return root / "transforms.json"


def test_fuzz_transforms(tmp_path):
    file = stated(tmp_path)
    read_all(tmp_path)
    assert min(fuzz_files(lambda: read_all(tmp_path), file, usual=60)) > 5


@pytest.mark.parametrize("text", [True, False])
def test_fuzz_colmap(colmap_scene, text):
    root = colmap_scene(count=3, size=(8, 6), text=text)
    model = pycolmap.Reconstruction(root / "sparse/0")
    for image in model.images.values():
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D([1.5 + i, 2.0]) for i in range(3)])
    for point, number in enumerate(sorted(model.images), 1):
        model.add_observation(point, pycolmap.TrackElement(number, 0))
    (model.write_text if text else model.write_binary)(root / "sparse/0")
    read_all(root)
    assert min(fuzz_files(lambda: read_all(root), *sorted((root / "sparse/0").iterdir()), usual=60)) > 5


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "webp", "gif", "bmp", "heic", "float.tif", "deep.png"])
def test_fuzz_photos_and_masks(tmp_path, suffix):
    file = tmp_path / f"a.{suffix}"
    pixels = np.random.default_rng(0).integers(0, 256, (9, 12, 3), dtype=np.uint8)
    kinds = {"float.tif": (pixels[..., 0] / 255).astype(np.float32), "deep.png": pixels[..., 0].astype(np.uint16) * 257}
    if suffix == "heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = 6, "One"
    Image.fromarray(kinds.get(suffix, pixels)).save(file, **({} if suffix in ("gif", "bmp") else {"exif": exif}))

    def read():
        image_size(file)
        assert read_image(file)[0].dtype == read_mask(file).dtype == np.uint8

    fuzz_files(read, file, usual=40)


@pytest.mark.parametrize("suffix", ["npy", "npz", "compressed.npz", "png"])
def test_fuzz_arrays_and_normal_maps(tmp_path, suffix):
    stated(tmp_path)
    frames = load_scene(tmp_path).frames[:1]
    maps = tmp_path / "normals"
    maps.mkdir()
    file = maps / f"000.{suffix.split('.')[-1]}"
    unit = np.tile(np.array([0, 0, -1], np.float32), (30, 40, 1))
    if suffix == "png":
        cv2.imwrite(str(file), np.rint((unit[..., ::-1] + 1) / 2 * 65535).astype(np.uint16))
    elif suffix == "npy":
        np.save(file, unit)
    else:
        (np.savez_compressed if "comp" in suffix else np.savez)(file, cam=unit)
    np.testing.assert_allclose(normal_maps(maps, frames)["000.png"]()[..., 2], -1, atol=1e-6)

    def read():
        if suffix != "png":
            headers(file)
            read_arrays(file)
        load_truth(tmp_path, frames)
        normal_maps(maps, frames)["000.png"]()

    assert fuzz_files(read, file, usual=40)[1] > (0 if suffix == "png" else 10)


def test_arrays_of_more_than_memory_holds_are_told(tmp_path):
    """A few hundred bytes that promise two terabytes."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (500000, 500000), }"
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w") as archive:
        archive.writestr("cam.npy", content)
    with pytest.raises(InputError, match=r"bomb.npz: .* takes 1.86e\+03 GiB of memory"):
        read_arrays(tmp_path / "bomb.npz")


def test_fuzz_truth(tmp_path):
    stated(tmp_path)
    frames = load_scene(tmp_path).frames[:1]
    depth, points = tmp_path / "depth/000.npz", tmp_path / "gt_points.npz"
    depth.parent.mkdir()
    np.savez(depth, depth=np.ones((30, 40), np.float32), label=np.ones((30, 40), np.uint8))
    np.savez(points, points=np.ones((4, 3)), normals=np.ones((4, 3)), label=np.zeros(4, np.uint8))

    def read():
        truth = load_truth(tmp_path, frames)
        for maps in (truth.depths, truth.labels):
            maps["000.png"]()

    assert fuzz_files(read, depth, points, usual=40)[0]


def test_fuzz_lists_and_clouds(tmp_path):
    stated(tmp_path)
    names = tmp_path / "hold_out.txt"
    names.write_text("# of these\n000.png\n001.png\n")
    fuzz_files(lambda: load_scene(tmp_path, hold_out=str(names)), tmp_path / "p.ply", names, usual=40)
