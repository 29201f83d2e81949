"""Which of several methods is selected, by shares that a witness is made to say."""

from typing import Any

import numpy as np
import pytest

from gsjax.errors import InputError, NoSurfaceError
from gsjax.meshing.select_method import Witness, select_method
from gsjax.scene.meshes import Mesh

EMPTY = np.zeros((0, 3))


def choice(margin=0.05, **shares: Any):
    """The choice among methods whose meshes agree by these shares; None: the method finds no surface."""
    meshes = {name: Mesh(EMPTY, EMPTY.astype(np.int32), EMPTY.astype(np.uint8)) for name in shares}
    says = {id(mesh): shares[name] for name, mesh in meshes.items()}

    def extract(name):
        if shares[name] is None:
            raise NoSurfaceError(f"{name} finds nothing")
        return meshes[name]

    methods = {name: lambda name=name: extract(name) for name in shares}
    return select_method(methods, Witness("what is known", lambda mesh: {"agrees": says[id(mesh)]}, margin))[0]


def test_the_usual_mesh_stays_unless_another_agrees_clearly_more():
    assert choice(usual=0.5, other=0.54) == "usual"
    assert choice(usual=0.5, other=0.56, best=0.57, worse=0.4) == "best"
    assert choice(usual=0.5, other=0.51, margin=0.0) == "other"


def test_what_finds_no_surface_is_passed_by():
    assert choice(usual=None, other=0.2, third=0.24) == "other"
    with pytest.raises(InputError, match="first finds nothing"):
        choice(first=None, second=None)
