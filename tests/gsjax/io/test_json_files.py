"""JSON files: a fault is one line at its place, whatever the file holds."""

import json

import pytest
from fuzzing import fuzz_files

from gsjax.errors import InputError
from gsjax.io import json_files

SHAPE = {
    "name": str,
    "K": [[float, 2], 2],
    "views": [{"width": int, "mask?": (None, str), "held_out": bool}],
    "machine": {str: object},
    "background": {"white", "black"},
}
RIGHT = {
    "name": "garden",
    "K": [[1, 2.5], [0, 1e9]],
    "views": [{"width": 3, "held_out": False}, {"width": 4, "mask": None, "held_out": True, "more": 1}],
    "machine": {"cpu": "some", "cores": 2},
    "background": "white",
    "not asked for": [1, None],
}


def changed(**parts):
    return {**RIGHT, **parts}


def test_what_has_the_shape_is_read(tmp_path):
    json_files.write(tmp_path / "a.json", RIGHT)
    assert json_files.read(tmp_path / "a.json", SHAPE) == RIGHT
    (tmp_path / "b.json").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "a.json").read_bytes())
    assert json_files.read(tmp_path / "b.json", SHAPE) == RIGHT


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "the whole is a list of 0, expected a table"),
        (changed(name=3), "name is 3, expected a text"),
        (changed(K=[[1, 2], [3]]), "K.1 is a list of 1, expected a list of 2"),
        (changed(K=[[1, 2], [3, float("inf")]]), "K.1.1 is inf, expected a finite number"),
        (changed(views=[{"held_out": True}]), "lacks 'views.0.width'"),
        (changed(background="grey"), "background is 'grey', expected one of black, white"),
    ],
)
def test_a_fault_is_named_at_its_place(tmp_path, data, message):
    (tmp_path / "a.json").write_text(json.dumps(data))
    with pytest.raises(InputError) as caught:
        json_files.read(tmp_path / "a.json", SHAPE)
    assert str(caught.value).startswith(f"{tmp_path / 'a.json'}: ") and message in str(caught.value)


def test_what_is_no_json_is_told(tmp_path):
    for data, message in (
        ("{}".encode("utf-16"), "is no JSON (not in UTF-8 from byte 0 on)"),
        (b"[" * 1_000_000, "is nested too deeply"),
    ):
        (tmp_path / "a.json").write_bytes(data)
        with pytest.raises(InputError) as caught:
            json_files.read(tmp_path / "a.json")
        assert str(caught.value).startswith(f"{tmp_path / 'a.json'}: {message}")


def test_fuzz_json(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(RIGHT))
    assert all(fuzz_files(lambda: json_files.read(path, SHAPE), path, usual=150))
