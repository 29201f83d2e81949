"""No product of the package is left to a GPU's matrix units at their default precision, ten bits of a float32.

Products are sums written out, or ask for the highest precision; here they are read off the traced programs.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxprs import equations
from meshes import square
from scenes import cloud as rasterizer_scene
from scenes import loss
from small_scenes import camera_at, cloud, photographed

import rasterizer
from gsjax import gaussians, rendering
from gsjax.analytic import solids
from gsjax.binding import bound as binding
from gsjax.binding import refinement
from gsjax.binding.mixed_gaussians import MixedGaussians
from gsjax.effects import background, exposure, poses, transients, vignetting
from gsjax.meshing import density_field
from gsjax.rendering import backdrop
from gsjax.scene import batches
from gsjax.scene.cameras import center
from gsjax.settings import Density, Rates
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import densify, initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step
from gsjax.training.terms import TERMS, weigh_terms
from gsjax.training.terms.mesh import neighboring_faces

PRODUCTS = "dot_general", "conv_general_dilated"
CAMERAS = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
OPTIMIZER = make_optimizer(Rates(), 1.0, 10)


def rough_products(function, *arguments):
    """The products of floats in a traced program that take whatever precision the device prefers."""
    program = list(equations(jax.make_jaxpr(function)(*arguments).jaxpr))
    assert program
    return [
        str(equation)
        for equation in program
        if equation.primitive.name in PRODUCTS
        and jnp.issubdtype(equation.outvars[0].aval.dtype, jnp.floating)
        and equation.params["precision"] != (jax.lax.Precision.HIGHEST,) * 2
    ]


def test_a_plain_product_in_a_loop_is_noticed():
    assert len(rough_products(jax.jit(lambda x: jax.lax.fori_loop(0, 2, lambda _, y: y @ x, x)), jnp.eye(3))) == 1


@pytest.mark.parametrize("backend", ["xla", "pallas"])
def test_the_rasterizer(backend):
    scene = rasterizer_scene(sh_degree=2)
    options = {
        "sh_degree": 2,
        "render_mode": "RGB+ED",
        "depth_mode": "plane",
        "rasterize_mode": "antialiased",
        "return_normals": True,
        "backgrounds": None,
    }
    program = partial(loss, backend=backend, capacity=2048, return_median_depth=True, **options)
    assert not rough_products(jax.grad(lambda s: program(s)[0]), scene)


@pytest.fixture(scope="module")
def target():
    photos = photographed(cloud(50, seed=5), CAMERAS, with_mattes=True)
    return batches.with_photo_numbers(batches.read_batches(photos)).views


def test_a_training_step_of_all_terms_and_effects_and_the_densification_after_it(target):
    def rate(step):
        return jnp.float32(0.01)

    centers = np.stack([center(camera) for camera in CAMERAS])
    effects = {
        "exposure": exposure.make_effect(np.zeros((3, 3)), rate),
        "vignetting": vignetting.make_effect(np.zeros((1, 2)), np.zeros(3), rate),
        "poses": poses.make_effect(centers, 4.0, np.zeros(3), 1, rate),
        "background": background.make_effect(backdrop.constant_coefficients(np.zeros(3), 2), rate),
        "transients": transients.make_effect(rate),
    }
    terms = weigh_terms(dict.fromkeys(TERMS.keys() - {"normal_consistency"}, 0.1))
    how = {"capacity": 4096, "background": BACKGROUNDS["random"], "sh_every": 4, "rule": DENSIFICATION_RULES["error"]}
    step = make_train_step(OPTIMIZER, terms, effects=effects, depth_mode="front", **how)
    state = initial_state(cloud(30, capacity=48, seed=1), OPTIMIZER, DENSIFICATION_RULES["error"], effects)
    maps = {"normals": np.full((24, 32, 3), 40, np.int8), "depth": np.full((24, 32), 2, np.float32)}
    here = batches.replace(target[0], neighbor=target[1], trust=np.full((24, 32), 255, np.uint8), **maps)
    here = batches.replace(here, sky=np.ones((24, 32), bool))
    assert not rough_products(step, state, here, jax.random.key(0))
    for rule in DENSIFICATION_RULES:
        grown = partial(densify, optimizer=OPTIMIZER, density=Density(), budget=48, rule=DENSIFICATION_RULES[rule])
        state = initial_state(cloud(30, capacity=48, seed=1), OPTIMIZER, DENSIFICATION_RULES[rule])
        assert not rough_products(grown, state, jax.random.key(0), jnp.float32(1.0), jnp.array(True))


def test_a_step_of_the_refinement(target):
    sheet = bound_sheet()
    settings = refinement.Refinement()
    optimizer = refinement.make_optimizer(settings, 1.0, len(sheet.vertices))
    how = {"capacity": 4096, "background": BACKGROUNDS["white"], "sh_every": 4}
    step = refinement.make_refine_step(optimizer, weigh_terms(settings.weights), **how)
    state = refinement.initial_state(MixedGaussians(sheet), optimizer)
    here = batches.replace(target[0], normals=np.full((24, 32, 3), 40, np.int8))
    assert not rough_products(step, neighboring_faces(np.asarray(sheet.faces)), state, here, jax.random.key(0))


FEW = cloud(30, seed=1)
FUNCTIONS = {
    "render": lambda: (partial(rendering.render, capacity=4096, with_depth=True), FEW, CAMERAS[0]),
    "covariances": lambda: (gaussians.covariances, FEW),
    "stages of gsplat": lambda: (stages_of_gsplat, rasterizer_scene()),
    "density": lambda: (density_field.density_gradient, FEW.means[0], density_field.kernels(FEW)),
    "the built-in scene": lambda: (partial(solids.trace, samples=1), CAMERAS[0]),
}


def stages_of_gsplat(scene):
    covars, _ = rasterizer.quat_scale_to_covar_preci(scene.quats, scene.scales)
    in_camera = rasterizer.world_to_cam(scene.means, covars, scene.viewmats)
    flat = rasterizer.proj(*in_camera, scene.Ks, scene.width, scene.height)
    shape = scene.means, None, scene.quats, scene.scales, scene.viewmats, scene.Ks
    return flat, rasterizer.fully_fused_projection(*shape, scene.width, scene.height)


def bound_sheet():
    return binding.bind(square(1, height=4.0), per_triangle=1, thickness=1e-3, sh_degree=0)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_the_library(name):
    function, *arguments = FUNCTIONS[name]()
    assert not rough_products(function, *arguments)
