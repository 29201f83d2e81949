import cv2
import numpy as np
import pytest
from PIL import Image

from gsjax.errors import InputError
from gsjax.io.scenes import is_data_set, load_scene
from gsjax.scene.similarity import IDENTITY


def read(path):
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def write_masks(root, names, mask):
    (root / "masks").mkdir()
    for name in names:
        cv2.imwrite(str(root / "masks" / name), mask)


def half_mask(width=40, height=30):
    """Off in the left quarter."""
    mask = np.full((height, width), 255, np.uint8)
    mask[:, : width // 4] = 0
    return mask


def test_a_selection_of_photos_is_held_out_as_among_all(colmap_scene, tmp_path):
    root, names = colmap_scene(count=18), [f"{i:03d}.png" for i in range(4, 10)]
    photo_list = tmp_path / "chosen.txt"
    photo_list.write_text("\n".join(names))
    scene = load_scene(root, photos=str(photo_list))
    assert [f.name for f in scene.frames] == names
    assert [f.name for f in scene.held_out_frames] == ["008.png"]
    for text, fault in ((names[0], "names one photo, at least 2"), ("9.png", "there is no photo")):
        photo_list.write_text(text)
        with pytest.raises(InputError, match=fault):
            load_scene(root, photos=str(photo_list))


def test_a_frame_keeps_pixels_intrinsics_and_pose(colmap_scene):
    root = colmap_scene()
    frame = load_scene(root, similarity=IDENTITY).frames[4]
    np.testing.assert_array_equal(frame.pixels().image, read(root / "images/004.png")[..., ::-1])
    np.testing.assert_array_equal(frame.K, np.array([[30, 0, 21], [0, 31, 14.5], [0, 0, 1]], np.float32))
    expected = np.eye(4, dtype=np.float32)
    expected[0, 3] = 0.4
    np.testing.assert_allclose(frame.viewmat, expected, atol=1e-7)
    assert frame.viewmat.dtype == frame.K.dtype == np.float32 and frame.pixels().image.dtype == np.uint8
    assert frame.pixels().matte is None and frame.pixels().valid is None


@pytest.mark.parametrize(("downscale", "size"), [(2.0, (20, 15)), (3.0, (13, 10)), (1.5, (27, 20)), (100.0, (1, 1))])
def test_downscale_averages_pixels_and_scales_each_axis_of_K_by_what_it_became(colmap_scene, downscale, size):
    root = colmap_scene()
    frame = load_scene(root, downscale=downscale).frames[0]
    width, height = size
    assert (frame.width, frame.height) == size
    sx, sy = width / 40, height / 30
    expected = np.array([[30 * sx, 0, 21 * sx], [0, 31 * sy, 14.5 * sy], [0, 0, 1]])
    np.testing.assert_allclose(frame.K, expected, rtol=1e-6)
    if downscale == 2.0:
        full = read(root / "images/000.png")[..., ::-1].astype(float)
        means = full.reshape(15, 2, 20, 2, 3).mean((1, 3))
        assert np.abs(frame.pixels().image - means).max() <= 0.5


ORIENTATION = 0x0112  # EXIF


def reduced(root, folder, suffix=".png"):
    """Moves the photos to `root / folder`, at half of their size."""
    (root / folder).mkdir(parents=True)
    for file in (root / "images").iterdir():
        small = cv2.resize(read(file), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str((root / folder / file.name).with_suffix(suffix)), small)
        file.unlink()
    (root / "images").rmdir()
    return root


def test_photos_of_another_size_rescale_their_camera_per_axis(colmap_scene):
    """80x62 to 40x31 exactly, and to 41x31: what the camera sees of a ray stays at the same share of the sides."""
    root = colmap_scene(count=3, model="SIMPLE_RADIAL", params=(60.0, 42.0, 29.0, 0.0), size=(80, 62))
    full = load_scene(root).frames[0]
    for name, width in (("000.png", 40), ("001.png", 41)):
        cv2.imwrite(str(root / "images" / name), np.full((31, width, 3), 7, np.uint8))
    exact, wider, whole = load_scene(root).frames
    assert [(f.width, f.height) for f in (exact, wider, whole)] == [(40, 31), (41, 31), (80, 62)]
    for frame in (exact, wider, whole):
        shares = np.array([[frame.width / 80], [frame.height / 62], [1]])
        np.testing.assert_allclose(frame.K, full.K * shares, rtol=1e-6)
        assert frame.pixels().image.shape == (frame.height, frame.width, 3)


def test_the_folder_asked_for_is_taken(colmap_scene, tmp_path, capsys):
    root = colmap_scene(count=3)
    reduced(root, "elsewhere/half")
    cv2.imwrite(str(root / "elsewhere/half/notes.jpg"), np.zeros((2, 2, 3), np.uint8))
    for folder in ("elsewhere/half", str(root / "elsewhere/half")):
        assert {(f.width, f.height) for f in load_scene(root, images=folder).frames} == {(20, 15)}
    assert capsys.readouterr().err == ""
    for name in ("nowhere", 300 * "x"):
        with pytest.raises(InputError, match=f"{name}: no such folder of images"):
            load_scene(root, images=name)
    (root / "elsewhere/half/001.png").unlink()
    assert [frame.name for frame in load_scene(root, images="elsewhere/half").frames] == ["000.png", "002.png"]
    assert "elsewhere/half/001.png: no such image; 1 of 3 photos is left out\n" in capsys.readouterr().err


def test_a_photo_is_found_by_its_stem_where_its_name_is_not_there(colmap_scene, capsys):
    root = colmap_scene(count=3)
    reduced(root, "images_2", suffix=".JPG")
    frames = load_scene(root).frames
    assert f"images: none where {root} says; {root / 'images_2'} is taken\n" in capsys.readouterr().err
    assert [f.name for f in frames] == ["000.png", "001.png", "002.png"]
    np.testing.assert_array_equal(frames[2].pixels().image, read(root / "images_2/002.JPG")[..., ::-1])
    cv2.imwrite(str(root / "images_2/002.jpeg"), np.zeros((15, 20, 3), np.uint8))  # which of the two?
    assert [f.name for f in load_scene(root, images="images_2").frames] == ["000.png", "001.png"]
    assert "images_2/002.png: no such image; 1 of 3 photos is left out\n" in capsys.readouterr().err


@pytest.mark.parametrize("orientation", [3, 6])
def test_photos_that_the_model_saw_turned_are_left_out(colmap_scene, orientation, capsys):
    """40x30 by its camera, stored as 30x40: only a quarter turn (6) explains that."""
    root = colmap_scene(count=3)
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.fromarray(np.zeros((40, 30, 3), np.uint8)).save(root / "images/001.png", exif=exif)
    reason = "stored as 30x40 and its EXIF" if orientation == 6 else "30x40 but its camera says 40x30"
    assert [frame.name for frame in load_scene(root).frames] == ["000.png", "002.png"]
    assert f"001.png: image is {reason}" in capsys.readouterr().err


@pytest.mark.parametrize(("value", "is_matte"), [(255, False), (77, False), (0, True)])
def test_an_alpha_channel_of_one_value_is_no_matte_unless_it_is_zero(colmap_scene, value, is_matte):
    """Zero everywhere: the object is not in this view; the first photo shows it."""
    root = colmap_scene(count=3)
    rgba = np.full((30, 40, 4), 90, np.uint8)
    rgba[..., 3] = value
    cv2.imwrite(str(root / "images/001.png"), rgba)
    rgba[:9, :9, 3] = 255 - value // 2
    cv2.imwrite(str(root / "images/000.png"), rgba)
    first, second, _ = load_scene(root).frames
    np.testing.assert_array_equal(first.pixels().matte, rgba[..., 3])
    assert (second.pixels().matte is not None) == is_matte


def test_folder_masks_as_validity_and_as_matte(colmap_scene, capsys):
    """By either name, of zeros and ones, and of half the size; one that fits nothing is named."""
    root = colmap_scene(count=4)
    write_masks(root, ["else.png"], half_mask())
    with pytest.raises(InputError, match="masks: no mask in it has the name of an image"):
        load_scene(root)
    for name, mask in (("000.png", half_mask() // 255), ("001.png.png", half_mask(20, 15)), ("002.png", half_mask())):
        cv2.imwrite(str(root / "masks" / name), mask)
    for use, other in (("valid", "matte"), ("matte", "valid")):
        pixels = [frame.pixels() for frame in load_scene(root, folder_masks=use).frames]
        for photo in pixels[:3]:
            np.testing.assert_array_equal(getattr(photo, use), half_mask())
            assert getattr(photo, other) is None
        assert pixels[3].valid is pixels[3].matte is None  # no mask of its own
    cv2.imwrite(str(root / "masks/000.png"), half_mask(20, 20))
    assert [frame.name for frame in load_scene(root).frames] == ["001.png", "002.png", "003.png"]
    assert "000.png: mask is 20x20 but its image 40x30; 1 of 4 photos is left out" in capsys.readouterr().err


def test_downscaled_validity_excludes_every_pixel_that_draws_from_a_masked_one(colmap_scene):
    root = colmap_scene(count=2)
    mask, expected = np.full((30, 40), 255, np.uint8), np.full((15, 20), 255, np.uint8)
    mask[8, 11] = expected[4, 5] = 0
    write_masks(root, ["000.png"], mask)
    np.testing.assert_array_equal(load_scene(root, downscale=2).frames[0].pixels().valid, expected)


def test_alpha_becomes_the_matte_and_averages_weigh_colours_by_it(colmap_scene):
    root = colmap_scene(count=2)
    rgba = np.zeros((30, 40, 4), np.uint8)
    rgba[:, ::2], rgba[:, 1::2] = (10, 20, 200, 255), (255, 255, 0, 85)
    rgba[:2, :, 3] = 0  # What is not there has no colour.
    cv2.imwrite(str(root / "images/000.png"), rgba)
    first, second = load_scene(root).frames
    np.testing.assert_array_equal(first.pixels().matte, rgba[..., 3])
    np.testing.assert_array_equal(first.pixels().image, rgba[..., 2::-1])
    assert second.pixels().matte is None
    half = load_scene(root, downscale=2).frames[0].pixels()
    assert not half.matte[0].any() and not half.image[0].any()
    expected = np.average([[200, 20, 10], [0, 255, 255]], axis=0, weights=[255, 85])
    assert np.abs(half.image[1:] - expected).max() <= 0.51 and np.abs(half.matte[1:].astype(int) - 170).max() <= 0.51


def test_distortion_removal_passes_masks_and_marks_what_it_must(colmap_scene):
    root = colmap_scene(model="SIMPLE_RADIAL", params=(30.0, 20.0, 15.0, 0.1), count=3)
    write_masks(root, [f"{i:03d}.png" for i in range(3)], half_mask())
    frame = load_scene(root).frames[0]
    assert frame.pixels().image.shape[:2] == frame.pixels().valid.shape
    x_edge = 10.0 - 20.0  # photo pixels from the principal point to the mask's edge, on the row through it
    undistorted = np.roots([0.1 / 30**2, 0, 1, -x_edge])
    edge = float(undistorted[np.abs(undistorted.imag) < 1e-9][0].real) + frame.K[0, 2]
    row = frame.pixels().valid[int(frame.K[1, 2])]
    first_valid = int(np.flatnonzero(row)[0])
    assert abs(first_valid + 0.5 - edge) <= 1.6  # a pixel counts once all that it draws from is on
    assert (row[first_valid:] == 255).all()


@pytest.mark.parametrize(("share", "suffix"), [(0.0, ".png"), (0.5, ".png"), (0.02, ".jpg"), (0.99, ".jpg")])
def test_truncated_images_are_left_out_and_named(colmap_scene, share, suffix, capsys):
    root = colmap_scene()
    file = root / "images/005.png"
    data = cv2.imencode(suffix, read(file))[1].tobytes()  # a JPEG under a PNG's name is read as what it is
    file.write_bytes(data[: int(share * len(data))])
    assert [frame.name for frame in load_scene(root).frames] == [f"{i:03d}.png" for i in range(10) if i != 5]
    message = capsys.readouterr().err
    assert "005.png: not a whole image" in message and message.endswith("; 1 of 10 photos is left out\n")
    assert message.count("\n") == 1


def test_a_folder_that_is_no_data_set_is_told_what_is_looked_for(tmp_path):
    with pytest.raises(InputError, match=r"no data set; searched sparse/0/cameras.bin .*transforms_train.json"):
        load_scene(tmp_path)
    for name in ("nowhere", 300 * "x"):
        with pytest.raises(InputError, match="no such folder"):
            load_scene(tmp_path / name)
    assert not is_data_set(tmp_path) and not is_data_set(tmp_path / "nowhere")
    (tmp_path / "transforms.json").touch()
    assert is_data_set(tmp_path)
