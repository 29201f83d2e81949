# %% [markdown]
# # Splat one Gaussian, and differentiate it
#
# A 3D Gaussian is rendered as a soft ellipse. The image of a single Gaussian and its derivatives have a closed form, so
# this notebook checks every step.

# %%
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import rasterizer

# %% [markdown]
# ## The camera
#
# The camera is at the origin and looks along z; x is right and y is down. The image has 65x49 pixels and a focal length
# of 60 pixels. The optical axis goes through the centre of the middle pixel.

# %%
WIDTH, HEIGHT, FOCAL = 65, 49, 60.0
viewmats = jnp.eye(4)[None]
Ks = jnp.array([[[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]])

# %% [markdown]
# ## The Gaussian
#
# It is on the axis, four units away, and twice as wide as high. `scales` are standard deviations along the axes of the
# Gaussian. `quats` (w, x, y, z) rotate these axes.

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
# ## Its image


# %%
def render(gaussian):
    colors, _, _ = rasterizer.rasterization(**gaussian, viewmats=viewmats, Ks=Ks, width=WIDTH, height=HEIGHT)
    return colors[0]


target = render(gaussian)
pyplot.imshow(target)
pyplot.title("one Gaussian")
pyplot.show()

# %% [markdown]
# ## The same by hand
#
# Projection scales lengths by focal length over depth. The rasterizer adds 0.3 square pixels to the variances, so that
# no splat falls between pixels. It skips a splat at pixels where its alpha is below 1/255.

# %%
x, y = np.meshgrid(np.arange(WIDTH) - WIDTH // 2, np.arange(HEIGHT) - HEIGHT // 2)
variance_x, variance_y = (np.asarray(scales[0, :2]) * FOCAL / DEPTH) ** 2 + 0.3
alpha = OPACITY * np.exp(-0.5 * (x**2 / variance_x + y**2 / variance_y))
alpha[alpha < 1 / 255] = 0

np.testing.assert_allclose(target, alpha[..., None] * np.asarray(orange), atol=1e-5)


# %% [markdown]
# ## The derivative of the image
#
# Moving the Gaussian by dx changes every pixel. The backend "reference" has forward mode, so `jax.jvp` computes the
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
# The right side gets brighter, the left side darker. By hand: the centre moves by `FOCAL / DEPTH` pixels per unit, and
# the slope of a Gaussian is its value times the distance over the variance. The shape of the splat does not change to
# first order.

# %%
np.testing.assert_allclose(change, alpha * (x / variance_x) * FOCAL / DEPTH, atol=1e-5)


# %% [markdown]
# ## The gradient of a loss
#
# Every backend has reverse mode: `jax.grad` differentiates one number to all parameters.


# %%
def brightness(gaussian):
    return jnp.sum(render(gaussian))


gradient = jax.grad(brightness)(gaussian)
print({name: np.round(np.asarray(value), 2).tolist() for name, value in gradient.items()})

# %% [markdown]
# The image is proportional to the opacity and to the colour. So the opacity times its derivative is the brightness. The
# colour times its derivative, summed over the channels, is the brightness too.

# %%
total = float(brightness(gaussian))
np.testing.assert_allclose(OPACITY * float(gradient["opacities"][0]), total, rtol=1e-5)
np.testing.assert_allclose(float(jnp.sum(orange * gradient["colors"])), total, rtol=1e-5)


# %% [markdown]
# ## Descend
#
# Gradient descent moves a Gaussian of another position and shape to the target image.


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
            capacity=256,  # maximum number of (tile, splat) pairs; a GPU needs it inside jit
        )
        return jnp.mean((colors[0] - target) ** 2), info["overflowed"]

    (value, overflowed), (to_means, to_scales) = jax.value_and_grad(loss, (0, 1), has_aux=True)(means, log_scales)
    return means - 4.0 * to_means, log_scales - 4.0 * to_scales, value, overflowed


means, log_scales = jnp.array([[-0.5, 0.4, DEPTH]]), jnp.log(jnp.full((1, 3), 0.4, jnp.float32))
start, losses = render({**gaussian, "means": means, "scales": jnp.exp(log_scales)}), []
for _ in range(150):
    means, log_scales, value, overflowed = step(means, log_scales)
    assert not overflowed
    losses.append(float(value))

# %%
end = render({**gaussian, "means": means, "scales": jnp.exp(log_scales)})
figure, panels = pyplot.subplots(1, 4, figsize=(13, 2.6))
for panel, title, image in zip(panels, ("start", "end", "target"), (start, end, target), strict=False):
    panel.imshow(image)
    panel.set_title(title)
panels[3].semilogy(losses)
panels[3].set_title("loss by step")
pyplot.show()

# %%
assert losses[-1] < 1e-3 * losses[0]
