# %% [markdown]
# # Splat one Gaussian, and differentiate it
#
# A Gaussian in space becomes a soft ellipse in the picture. For a single one, the picture and its derivatives have a
# closed form, so every step can be checked.

# %%
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import rasterizer

# %% [markdown]
# ## The camera
#
# It stands at the origin and looks along z; x is right and y down. A focal length of 60 pixels, the axis through the
# middle of a picture of 65x49 pixels: the middle pixel's centre lies on it.

# %%
WIDTH, HEIGHT, FOCAL = 65, 49, 60.0
viewmats = jnp.eye(4)[None]
Ks = jnp.array([[[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]])

# %% [markdown]
# ## The Gaussian
#
# Four units away, on the axis, twice as wide as high. `scales` are standard deviations along its own axes, which
# `quats` (w, x, y, z) turn.

# %%
DEPTH, OPACITY = 4.0, 0.8
scales = jnp.array([[0.6, 0.3, 0.1]])
orange = jnp.array([[1.0, 0.55, 0.1]])
gaussian = {
    "means": jnp.array([[0.0, 0.0, DEPTH]]),
    "quats": jnp.array([[1.0, 0.0, 0.0, 0.0]]),
    "scales": scales,
    "opacities": jnp.array([OPACITY]),
    "colors": orange,
}


# %% [markdown]
# ## Its picture


# %%
def picture(gaussian):
    colors, _, _ = rasterizer.rasterization(**gaussian, viewmats=viewmats, Ks=Ks, width=WIDTH, height=HEIGHT)
    return colors[0]


target = picture(gaussian)
pyplot.imshow(target)
pyplot.title("one Gaussian")
pyplot.show()

# %% [markdown]
# ## The same by hand
#
# Projection scales lengths by focal length over depth. The covariance in the picture gets 0.3 square pixels more, so
# that no splat falls between pixels. What covers a pixel by less than 1/255 is left out.

# %%
x, y = np.meshgrid(np.arange(WIDTH) - WIDTH // 2, np.arange(HEIGHT) - HEIGHT // 2)
variance_x, variance_y = (np.asarray(scales[0, :2]) * FOCAL / DEPTH) ** 2 + 0.3
alpha = OPACITY * np.exp(-0.5 * (x**2 / variance_x + y**2 / variance_y))
alpha[alpha < 1 / 255] = 0

np.testing.assert_allclose(target, alpha[..., None] * np.asarray(orange), atol=1e-5)


# %% [markdown]
# ## The derivative of the picture
#
# Move the Gaussian by dx: every pixel changes. The dense backend differentiates in any mode, so `jax.jvp` gives the
# change of all pixels at once.


# %%
def moved(dx):
    means = gaussian["means"] + jnp.stack([dx, 0.0, 0.0])[None]
    options = {"width": WIDTH, "height": HEIGHT, "backend": "reference"}
    colors, _, _ = rasterizer.rasterization(**{**gaussian, "means": means}, viewmats=viewmats, Ks=Ks, **options)
    return colors[0, ..., 0]


_, change = jax.jvp(moved, (0.0,), (1.0,))
pyplot.imshow(change, cmap="coolwarm")
pyplot.colorbar(label="change of red per unit of x")
pyplot.show()

# %% [markdown]
# On its right side the picture gets brighter, on its left darker. By hand: the centre moves by `FOCAL / DEPTH` pixels
# per unit, and the bell's slope is its value times the distance over the variance. (That a splat off the axis is seen a
# little askew changes its shape, but not to first order.)

# %%
np.testing.assert_allclose(change, alpha * (x / variance_x) * FOCAL / DEPTH, atol=1e-5)


# %% [markdown]
# ## The gradient of a loss
#
# The fast backend has reverse mode, which is what `jax.grad` wants: one number, and its derivative to everything.


# %%
def brightness(gaussian):
    return jnp.sum(picture(gaussian))


gradient = jax.grad(brightness)(gaussian)
print({name: np.round(np.asarray(value), 2).tolist() for name, value in gradient.items()})

# %% [markdown]
# The picture is proportional to opacity and to colour. So opacity times its derivative is the brightness, and so is the
# sum over the colour's channels.

# %%
total = float(brightness(gaussian))
np.testing.assert_allclose(OPACITY * float(gradient["opacities"][0]), total, rtol=1e-5)
np.testing.assert_allclose(float(jnp.sum(orange * gradient["colors"])), total, rtol=1e-5)


# %% [markdown]
# ## Descend
#
# A Gaussian in the wrong place and of the wrong shape goes to where the picture is: steps against the gradient, a
# little different for lengths and for places.


# %%
@jax.jit
def step(means, log_scales):
    def loss(means, log_scales):
        colors, _, info = rasterizer.rasterization(
            **{**gaussian, "means": means, "scales": jnp.exp(log_scales)},
            viewmats=viewmats,
            Ks=Ks,
            width=WIDTH,
            height=HEIGHT,
            capacity=256,  # of the lists of splats a tile; inside jit it cannot be counted
        )
        return jnp.mean((colors[0] - target) ** 2), info["overflowed"]

    (value, overflowed), (to_means, to_scales) = jax.value_and_grad(loss, (0, 1), has_aux=True)(means, log_scales)
    return means - 4.0 * to_means, log_scales - 4.0 * to_scales, value, overflowed


means, log_scales = jnp.array([[-0.5, 0.4, DEPTH]]), jnp.log(jnp.full((1, 3), 0.4, jnp.float32))
start, losses = picture({**gaussian, "means": means, "scales": jnp.exp(log_scales)}), []
for _ in range(150):
    means, log_scales, value, overflowed = step(means, log_scales)
    assert not overflowed
    losses.append(float(value))

# %%
end = picture({**gaussian, "means": means, "scales": jnp.exp(log_scales)})
figure, panels = pyplot.subplots(1, 4, figsize=(13, 2.6))
for panel, title, image in zip(panels, ("start", "end", "wanted"), (start, end, target), strict=False):
    panel.imshow(image)
    panel.set_title(title)
panels[3].semilogy(losses)
panels[3].set_title("loss by step")
pyplot.show()

# %%
assert losses[-1] < 1e-3 * losses[0]
