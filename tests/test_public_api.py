import inspect
import re
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from jax import Array

import gsjax
import rasterizer

DOCS = Path(__file__).resolve().parents[1] / "docs"
PUBLIC = [(package, name) for package in (rasterizer, gsjax) for name in package.__all__]
IDS = [f"{package.__name__}.{name}" for package, name in PUBLIC]


@pytest.mark.parametrize(("package", "name"), PUBLIC, ids=IDS)
def test_every_public_name_is_documented_and_listed_and_its_arrays_have_shapes(package, name):
    assert re.search(rf"`{package.__name__}\.{name}`", (DOCS / "api.md").read_text()), "not listed in docs/api.md"
    value = getattr(package, name)
    if inspect.isclass(value) or inspect.isfunction(value):
        assert inspect.getdoc(value), f"{name} has no docstring"
        hints = get_type_hints(value).items()
        bare = {key for key, hint in hints if any(part in (Array, np.ndarray) for part in (hint, *get_args(hint)))}
        assert bare == {"densify": {"key"}}.get(name, set())
