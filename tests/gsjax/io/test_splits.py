"""Which files show the same shot, and which photos are held out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from gsjax.errors import InputError
from gsjax.io.lenses import Lens
from gsjax.io.photos import Photo
from gsjax.io.splits import group_duplicates, mark_held_out

LENS = Lens("PINHOLE", 240, 160, (200.0, 200.0, 120.0, 80.0))


def texture(seed, width=240, height=160):
    """`[H, W, 3]` uint8: blurred noise, as natural pictures fall off towards high frequencies."""
    noise = np.random.default_rng(seed).normal(size=(height, width, 3))
    smooth = sum(sigma * gaussian_filter(noise, (sigma, sigma, 0), mode="wrap") for sigma in (1, 4, 16))
    return np.uint8(np.clip(128 + 50 * smooth / smooth.std(), 0, 255))


def save(folder, pictures):
    """Files by name."""
    folder.mkdir(exist_ok=True, parents=True)
    for name, picture in pictures.items():
        Image.fromarray(picture).save(folder / name)
    return [folder / name for name in sorted(pictures)]


def named(files):
    return [[files[index].name for index in shot] for shot in group_duplicates(files)]


def turned(picture, path):
    """The same picture stored on its side, with the EXIF orientation that turns it back."""
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.ascontiguousarray(np.rot90(picture))).save(path, exif=exif, quality=90)


@pytest.mark.parametrize(
    "copy",
    [
        lambda image, path: image.save(path, quality=60),
        lambda image, path: image.resize((120, 80), Image.Resampling.LANCZOS).save(path, quality=80),
        lambda image, path: turned(np.asarray(image), path),
        lambda image, path: image.point(lambda level: round(0.9 * level)).save(path, quality=90),
    ],
    ids=["re-encoded", "half the size", "turned by EXIF", "darker"],
)
def test_a_copy_of_any_kind_is_the_same_shot(tmp_path, copy):
    pictures = {f"{n}.png": texture(n) for n in range(4)}
    files = save(tmp_path, pictures)
    copy(Image.fromarray(pictures["2.png"]), tmp_path / "z.jpg")
    files = sorted(tmp_path.iterdir())
    assert named(files) == [["0.png"], ["1.png"], ["2.png", files[-1].name], ["3.png"]]


def test_frames_of_a_slow_video_are_not_one_shot(tmp_path):
    """A window that moves by two of 240 pixels a frame; and one that moves by a sixth of a pixel, group by group."""
    wide = texture(0, width=400)
    files = save(tmp_path / "slow", {f"{n:02d}.png": wide[:, 2 * n : 240 + 2 * n] for n in range(12)})
    assert len(group_duplicates(files)) == 12
    fine = np.asarray(Image.fromarray(wide).resize((2400, 160), Image.Resampling.BICUBIC))
    creeping = {f"{n:03d}.png": fine[:, n : 1440 + n : 6] for n in range(40)}
    sizes = [len(shot) for shot in group_duplicates(save(tmp_path / "creeping", creeping))]
    assert max(sizes) <= 15


def test_views_without_texture_are_not_one_shot(tmp_path):
    """A bare wall: shades of a few levels that differ from view to view; and photos of one colour, or none at all."""
    wall = {f"{n}.png": np.uint8(np.clip(200 + (texture(n).astype(int) - 128) // 24, 0, 255)) for n in range(6)}
    flat = {f"{n}f.png": np.full((16, 24, 3), 200, np.uint8) for n in range(3)}
    (tmp_path / "x.png").write_bytes(b"no photo")
    files = [*save(tmp_path, wall | flat), tmp_path / "x.png", tmp_path / "absent.png"]
    assert len(group_duplicates(files)) == 11


def photos_of(files, held_out=()):
    return [Photo(file.name, file, np.eye(4), LENS, held_out=file.name in held_out) for file in files]


NAMES = [f"{i:03d}.jpg" for i in range(18)]
PHOTOS = photos_of(map(Path, NAMES))


def held_out(hold_out, root, photos=PHOTOS):
    marked = mark_held_out(photos, hold_out, root)
    assert [photo.name for photo in marked] == [photo.name for photo in photos]
    return [photo.name for photo in marked if photo.held_out]


def test_a_shot_is_held_out_with_all_of_its_files(tmp_path):
    """Ten shots, each as a PNG and as a JPEG whose name sorts elsewhere: the first and the ninth are held out."""
    shots = ((n, texture(n)) for n in range(10))
    files = save(tmp_path, {name: shot for n, shot in shots for name in (f"a{n}.png", f"z{9 - n}.jpg")})
    photos = photos_of(files)
    assert held_out("auto", tmp_path, photos) == ["a0.png", "a8.png", "z1.jpg", "z9.jpg"]
    assert held_out("5", tmp_path, photos) == ["a0.png", "a5.png", "z4.jpg", "z9.jpg"]


@pytest.mark.parametrize("stated", ["own", "hold_out.txt", "mine.txt"])
def test_copies_of_photos_that_a_split_names_are_held_out_with_them(tmp_path, capfd, stated):
    files = save(tmp_path / stated / "images", {**{f"a{n}.png": texture(n) for n in range(4)}, "c.png": texture(2)})
    root = tmp_path / stated
    if stated != "own":
        (root / stated).write_text("a2.png\n")
    photos = photos_of(files, ["a2.png"] if stated == "own" else [])
    assert held_out(str(root / stated) if stated == "mine.txt" else "auto", root, photos) == ["a2.png", "c.png"]
    assert f"{root}: held out as well, as duplicates of held-out photos: c.png" in capfd.readouterr().err
    assert held_out("none", root, [replace(photo, held_out=True) for photo in photos]) == []


def test_a_list_in_a_file_and_the_data_sets_own_list(tmp_path):
    """A name that looks like a comment or ends in a space is a name where a photo has it."""
    text = f"# a comment\n\n  {NAMES[4]}  \r\n{NAMES[1]}\n{NAMES[4]}\n"
    (tmp_path / "mine.txt").write_text(text)
    assert held_out(str(tmp_path / "mine.txt"), tmp_path) == [NAMES[1], NAMES[4]]
    (tmp_path / "hold_out.txt").write_text(text)
    assert held_out("auto", tmp_path) == [NAMES[1], NAMES[4]]
    odd = photos_of(map(Path, ("#1.jpg", " 2.jpg ", "3.jpg")))
    (tmp_path / "hold_out.txt").write_text("# of these\n#1.jpg\n 2.jpg \n")
    assert held_out("auto", tmp_path, odd) == ["#1.jpg", " 2.jpg "]


@pytest.mark.parametrize(
    ("hold_out", "content", "message"),
    [
        ("list.txt", b"#\n\n007.jpeg", "list.txt, line 3: there is no photo 007.jpeg; the nearest name is 007.jpg"),
        ("list.txt", b"\xff\xfe\x00", "list.txt: cannot be read as a list of photos"),
        ("gone.txt", b"", "gone.txt: no such list of photos; hold_out takes a number, none, or a file"),
        ("1", b"", "hold_out=1: every N-th photo needs an N of at least 2"),
    ],
)
def test_what_is_no_split_is_one_line(tmp_path, monkeypatch, hold_out, content, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "list.txt").write_bytes(content)
    with pytest.raises(InputError) as error:
        mark_held_out(PHOTOS, hold_out, tmp_path)
    assert str(error.value).startswith(message) and "\n" not in str(error.value)
