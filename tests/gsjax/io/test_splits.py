from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io.lenses import Lens
from gsjax.io.photos import Photo
from gsjax.io.splits import mark_held_out

NAMES = [f"{i:03d}.jpg" for i in range(18)]
LENS = Lens("PINHOLE", 4, 3, (5.0, 5.0, 2.0, 1.5))
PHOTOS = [Photo(name, Path(name), np.eye(4), LENS) for name in NAMES]


def held_out(hold_out, root, photos=PHOTOS):
    marked = mark_held_out(photos, hold_out, root)
    assert [photo.name for photo in marked] == [photo.name for photo in photos]
    return [photo.name for photo in marked if photo.held_out]


def test_the_layouts_own_split_is_the_default_and_gives_way_to_another(tmp_path):
    own = [replace(photo, held_out=photo.name in NAMES[3:5]) for photo in PHOTOS]
    assert held_out("auto", tmp_path, own) == NAMES[3:5]
    assert held_out("8", tmp_path, own) == NAMES[::8]
    assert held_out("none", tmp_path, own) == []


def test_a_name_that_looks_like_a_comment_or_ends_in_a_space_is_one_if_a_photo_has_it(tmp_path):
    odd = [replace(photo, name=name) for photo, name in zip(PHOTOS, ("#1.jpg", " 2.jpg ", "3.jpg"), strict=False)]
    (tmp_path / "hold_out.txt").write_text("# of these\n#1.jpg\n 2.jpg \n")
    assert held_out("auto", tmp_path, odd) == ["#1.jpg", " 2.jpg "]


def test_a_list_in_a_file_and_the_data_sets_own_list(tmp_path):
    text = f"# a comment\n\n  {NAMES[4]}  \r\n{NAMES[1]}\n{NAMES[4]}\n"
    (tmp_path / "mine.txt").write_text(text)
    assert held_out(str(tmp_path / "mine.txt"), tmp_path) == [NAMES[1], NAMES[4]]
    (tmp_path / "hold_out.txt").write_text(text)
    assert held_out("auto", tmp_path) == [NAMES[1], NAMES[4]]
    assert held_out("none", tmp_path) == []


@pytest.mark.parametrize(
    ("hold_out", "content", "message"),
    [
        (
            "list.txt",
            "000.jpg\n\n007.jpeg\n",
            "list.txt, line 3: there is no photo 007.jpeg; the nearest name is 007.jpg",
        ),
        ("list.txt", "# none\n", "list.txt: names no photo; --hold-out none holds none out"),
        ("list.txt", b"\xff\xfe\x00", "list.txt: cannot be read as a list of photos"),
        ("gone.txt", "", "gone.txt: no such list of photos; --hold-out takes a number, none, or a file"),
        ("0", "", "--hold-out 0: every N-th photo needs an N of at least 2"),
        ("1", "", "--hold-out 1: every N-th photo needs an N of at least 2"),
    ],
)
def test_what_is_no_split_is_one_line(tmp_path, monkeypatch, hold_out, content, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "list.txt").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as error:
        mark_held_out(PHOTOS, hold_out, tmp_path)
    assert str(error.value).startswith(message) and "\n" not in str(error.value)
