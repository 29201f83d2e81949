"""What a call does not ask for is not in its program, and no array grows with tiles x splats: read off the jaxpr."""

from collections import Counter
from dataclasses import replace

import jax
import numpy as np
import pytest
from jaxprs import equations
from scenes import cloud, loss, render

COUNT = 41  # Like no other size in the program.


def forward(scene, capacity=2048, **options):
    options = {"backend": "xla", **options}  # The native loops are one call each: nothing of them can be counted.
    return list(equations(jax.make_jaxpr(lambda s: render(s, capacity=capacity, **options)[:2])(scene).jaxpr))


def forward_and_backward(scene, capacity=2048, **options):
    options = {"backend": "xla", **options}
    gradient = jax.grad(lambda s: loss(s, capacity=capacity, **options)[0])
    return list(equations(jax.make_jaxpr(gradient)(scene).jaxpr))


def shapes(program):
    return {v.aval.shape for e in program for v in (*e.invars, *e.outvars)}


def uses_constant(program, constant):
    values = [v.val for e in program for v in e.invars if hasattr(v, "val") and np.ndim(v.val) == 0]
    return any(abs(abs(float(v)) - constant) < 1e-6 for v in values)


def transparent(scene):
    return replace(scene, backgrounds=None)


@pytest.mark.parametrize(
    ("mode", "channels", "of_planes"),
    [("RGB", 3, 3), ("ED", 1, 3), ("RGB+D", 4, 6)],
)
def test_only_the_channels_of_the_mode_are_blended(mode, channels, of_planes):
    scene = transparent(cloud(COUNT))
    programs = {"center": forward_and_backward(scene, render_mode=mode)}
    programs["plane"] = forward(scene, render_mode=mode, depth_mode="plane")
    # A splat's row: mean 2, conic 3, opacity 1, and what is blended.
    blended = {name: {c for c in (1, 3, 4, 6) if (COUNT, 6 + c) in shapes(each)} for name, each in programs.items()}
    assert blended == {"center": {channels}, "plane": {of_planes}}
    if mode == "RGB":
        assert operations(programs["plane"]) == operations(forward(scene))


def test_only_the_bands_of_the_degree_are_evaluated():
    program = forward(cloud(COUNT, sh_degree=4), sh_degree=1)
    leading_constants = [0.282094791, 0.488602512, 1.09254843, 0.590043589, 2.50334294]
    assert [uses_constant(program, c) for c in leading_constants] == [True, True, False, False, False]


def operations(program):
    """How many equations of each primitive."""
    return Counter(e.primitive.name for e in program)


def test_an_option_adds_its_operations_and_its_absence_none():
    scene = transparent(cloud(COUNT))
    without = operations(forward(scene))
    for options, primitive in (({"rasterize_mode": "antialiased"}, "sqrt"), ({"return_normals": True}, "argmin")):
        assert operations(forward(scene, **options))[primitive] > without[primitive]


def test_no_array_of_tiles_by_splats_nor_of_pairs_by_pixels():
    scene, capacity = cloud(2000, size=(256, 192)), 16384
    num_tiles, channels = 32 * 24, 3
    largest = max(np.prod(shape) for shape in shapes(forward_and_backward(scene, capacity)))
    assert largest < num_tiles * 2000 / 4
    assert largest < capacity * 64 / 2
    # What there is: a few numbers per pair, and the image.
    assert largest <= max(capacity * (6 + channels + 3), 2 * 256 * 192 * (channels + 1))
