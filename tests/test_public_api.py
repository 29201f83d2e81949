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
