import importlib
import inspect
import re
from pathlib import Path

import pytest

import gsjax
import rasterizer

DOCS = Path(__file__).resolve().parents[1] / "docs"
PUBLIC = [(package, name) for package in (rasterizer, gsjax) for name in package.__all__]


@pytest.mark.parametrize(("package", "name"), PUBLIC, ids=[f"{p.__name__}.{n}" for p, n in PUBLIC])
def test_every_public_name_is_documented_and_listed(package, name):
    value = getattr(package, name)
    if inspect.isclass(value) or inspect.isfunction(value):
        assert inspect.getdoc(value), f"{name} has no docstring"
    assert re.search(rf"`{package.__name__}\.{name}`", (DOCS / "api.md").read_text()), "not listed in docs/api.md"


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'gsjax' has no attribute 'Nothing'"):
        _ = gsjax.Nothing


def test_what_the_map_of_the_paper_points_to_exists():
    text = (DOCS / "paper_map.md").read_text()
    functions = re.findall(r"`(gsjax(?:\.\w+)+)`", text)
    tests = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", text)
    assert functions
    assert tests
    for dotted in functions:
        module, _, name = dotted.rpartition(".")
        assert hasattr(importlib.import_module(module), name), dotted
    for file, name in tests:
        path = DOCS.parent / file
        assert path.is_file(), file
        assert f"def {name}" in path.read_text(), f"{file}::{name}"
