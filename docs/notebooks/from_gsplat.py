# %% [markdown]
# # Coming from gsplat
#
# `rasterizer.rasterization` has gsplat's argument names and order. Four things are different in JAX, and each has a
# cell: gradients, compilation, batches and `absgrad`.

# %%
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import rasterizer
from rasterizer import rasterization

# %% [markdown]
# ## The call
#
# The call in torch was
#
#     from gsplat import rasterization
#     colors, alphas, info = rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height)
#
# The call in JAX is the same. Scales and opacities are linear. Quaternions are (w, x, y, z) of any length. Camera
# matrices are world to camera with x right, y down, z forward.

# %%
COUNT, WIDTH, HEIGHT = 400, 96, 72
rng = np.random.default_rng(0)


def array(values):
    return jnp.asarray(values, jnp.float32)


means = array(rng.uniform([-2, -1.5, 3], [2, 1.5, 5], (COUNT, 3)))
quats = array(rng.normal(size=(COUNT, 4)))
scales = array(np.exp(rng.normal(-2.3, 0.4, (COUNT, 3))))
opacities = array(rng.uniform(0.2, 1, COUNT))
rgb = array(rng.uniform(size=(COUNT, 3)))
viewmats = jnp.stack([jnp.eye(4), jnp.eye(4).at[0, 3].set(0.5)])
Ks = jnp.tile(array([[80, 0, WIDTH / 2], [0, 80, HEIGHT / 2], [0, 0, 1]]), (2, 1, 1))

colors, alphas, info = rasterization(means, quats, scales, opacities, rgb, viewmats, Ks, WIDTH, HEIGHT)
print("colors", colors.shape, "alphas", alphas.shape, "info:", ", ".join(info))

figure, panels = pyplot.subplots(1, 2, figsize=(9, 3.4))
for panel, image in zip(panels, colors, strict=True):
    panel.imshow(jnp.clip(image, 0, 1))
pyplot.show()

# %% [markdown]
# ## The stages
#
# gsplat's stages have their names. Composed they give the same image.

# %%
radii, means2d, depths, conics, _ = rasterizer.fully_fused_projection(
    means, None, quats, scales, viewmats, Ks, WIDTH, HEIGHT, eps2d=0.3
)
tile_size = 16
tiles = -(-WIDTH // tile_size), -(-HEIGHT // tile_size)
_, isect_ids, flatten_ids = rasterizer.isect_tiles(means2d, radii, depths, tile_size, *tiles)
offsets = rasterizer.isect_offset_encode(isect_ids, 2, *tiles)
staged, _ = rasterizer.rasterize_to_pixels(
    means2d,
    conics,
    jnp.tile(rgb, (2, 1, 1)),
    jnp.tile(opacities, (2, 1)),
    WIDTH,
    HEIGHT,
    tile_size,
    offsets,
    flatten_ids,
)
np.testing.assert_allclose(staged, colors, atol=2e-3)

# %% [markdown]
# ## Gradients
#
# There is no `.backward()`: `jax.grad` returns the function that computes the gradient to any input, cameras included.
# This cell compares the gradient to the position of the first camera with finite differences. They differ by some
# percent: a splat ends where its alpha falls below 1/255, and only the differences include the motion of this edge.

# %%
weights = array(rng.normal(size=(HEIGHT, WIDTH, 3)))


def loss(shift):
    moved = viewmats.at[0, :3, 3].add(shift)
    return jnp.sum(weights * rasterization(means, quats, scales, opacities, rgb, moved, Ks, WIDTH, HEIGHT)[0][0])


gradient = jax.grad(loss)(jnp.zeros(3))
steps = 3e-3 * jnp.eye(3)
differences = [(loss(step) - loss(-step)) / 6e-3 for step in steps]
print("gradient:", np.round(np.asarray(gradient), 2), " differences:", np.round(np.asarray(differences), 2))
np.testing.assert_allclose(gradient, differences, rtol=0.1, atol=1.0)

# %% [markdown]
# ## Compilation
#
# Inside `jax.jit` all sizes are static, also that of the list of (tile, Gaussian) pairs. `capacity` is its size, and
# `info["overflowed"]` is true where it was too small. An image that overflowed must not be used.


# %%
@jax.jit
def compiled_render(means):
    colors, _, info = rasterization(
        means, quats, scales, opacities, rgb, viewmats, Ks, WIDTH, HEIGHT, capacity=rasterizer.capacity_bucket(8000)
    )
    return colors, info["needed"], info["overflowed"]


compiled, needed, overflowed = compiled_render(means)
print(f"{int(needed):,} pairs were needed")
assert not overflowed
np.testing.assert_allclose(compiled, colors, atol=1e-5)

# %% [markdown]
# ## Batches
#
# Leading dimensions are scenes, as in gsplat. `jax.vmap` maps over anything else. This cell renders three scenes that
# differ in the translation of the Gaussians.

# %%
shifts = array([[0.0, 0, 0], [0.3, 0, 0], [0.6, 0, 0]])


def shifted(shift):
    return rasterization(means + shift, quats, scales, opacities, rgb, viewmats, Ks, WIDTH, HEIGHT)[0]


many = jax.vmap(shifted)(shifts)
print("many:", many.shape)
np.testing.assert_allclose(many[0], colors, atol=1e-5)

# %% [markdown]
# ## absgrad
#
# AbsGS splits a Gaussian by the sum over pixels of *absolute* gradients to its 2D mean, because signed gradients of
# pixels cancel. gsplat writes this sum to `means2d.absgrad`. A function of JAX has no side effects, so `absgrad` takes
# zeros. The image does not depend on them, and their gradient is the sum.


# %%
def loss_of_image(moved, zeros):
    """A loss of both images, with moved 2D means."""
    both = [jnp.tile(x, (2,) + (1,) * x.ndim) for x in (rgb, opacities)]
    image, _ = rasterizer.rasterize_to_pixels(
        means2d + moved, conics, *both, WIDTH, HEIGHT, tile_size, offsets, flatten_ids, absgrad=zeros
    )
    return jnp.sum(weights * image)


zeros = jnp.zeros_like(means2d)
signed, absolute = jax.grad(loss_of_image, (0, 1))(zeros, zeros)
assert jnp.all(absolute >= jnp.abs(signed) - 1e-2)

signed, absolute = (jnp.linalg.norm(x[0], axis=-1) for x in (signed, absolute))
pyplot.plot(signed, absolute, ".", markersize=3)
pyplot.axline((0, 0), slope=1, color="black", linestyle=":")
pyplot.xlabel("length of the gradient to the 2D mean")
pyplot.ylabel("with absolute values")
pyplot.show()

# %% [markdown]
# [Coming from gsplat](../gsplat.md) lists the other differences, argument by argument, with their errors.
