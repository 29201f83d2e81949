# %% [markdown]
# # Write your own loss
#
# A loss is a function of the Gaussians, their render and the photo. This notebook writes one, checks it by hand, trains
# with it and without it, and compares the results.

# %%
import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import gsjax

# %% [markdown]
# ## The loss
#
# Needles are Gaussians that are much longer than wide. They stick out of a surface when the camera moves. This loss
# penalises the logarithm of length over width beyond a limit of 1.2. It is a mean over the visible Gaussians, so that
# its weight does not depend on their number.

# %%
LIMIT = 1.2


def excess(gaussians):
    """[N] logarithm of the longest axis over `LIMIT` times the second one, at least 0."""
    _, second, longest = jnp.sort(jnp.log(gsjax.scales(gaussians)), axis=-1).T
    return jnp.maximum(longest - second - jnp.log(LIMIT), 0)


def needles(gaussians, view, photo):
    """Mean excess of the visible Gaussians."""
    visible = view.splats.projection.visible[0]
    return jnp.sum(jnp.where(visible, excess(gaussians), 0)) / jnp.maximum(jnp.sum(visible), 1)


# %% [markdown]
# ## Check it by hand
#
# Three Gaussians: a ball, a needle of twice the limit, and one exactly at the limit. Only the needle has a loss,
# log 2. Its gradient shortens the longest axis and widens the second one by the same factor.

# %%
three = gsjax.from_points(np.zeros((3, 3)), np.full((3, 3), 0.5), capacity=3, sh_degree=0)
three = replace(three, log_scales=jnp.log(jnp.array([[1, 1, 1], [1, 2.4, 0.1], [1, 1.2, 0.1]])))
np.testing.assert_allclose(excess(three), [0, np.log(2), 0], atol=1e-6)

gradient = jax.grad(lambda gaussians: excess(gaussians)[1])(three)
np.testing.assert_allclose(gradient.log_scales[1], [-1, 1, 0], atol=1e-6)

# %% [markdown]
# ## Train
#
# This is a complete training loop. `losses` maps a name to a weight, or to a weight and a function. Every function here
# is public, so each line can be replaced by your own.

# %%
STEPS = 120
scene = gsjax.load_scene(gsjax.write_built_in_scene("scene", num_views=9, size=(40, 40)))
views = gsjax.read_views(scene.train_frames)


def train(losses):
    """The Gaussians after training, and the PSNR of every step."""
    gaussians = gsjax.from_points(scene.points, scene.point_colors, capacity=800, sh_degree=0)
    optimizer = gsjax.adam(scene.extent, steps=STEPS)
    step = gsjax.train_step(optimizer, losses, densify="error", background="white")
    state, key, psnrs = gsjax.init(gaussians, optimizer), jax.random.key(0), []
    for i, view in zip(range(STEPS), itertools.cycle(views)):
        state, metrics = step(state, view, key)
        psnrs.append(float(metrics.psnr))
        if i % 20 == 19:
            state = gsjax.densify(state, key)
    return state.gaussians.alive(), psnrs


image = {"l1": 0.8, "dssim": 0.2}
results = {"without": train(image), "with": train({**image, "needles": (0.2, needles)})}

# %% [markdown]
# ## Compare
#
# With the loss most needles are gone, and the photos are fitted almost as well.


# %%
def ratios(gaussians):
    """Length over width."""
    _, second, longest = np.sort(np.asarray(gsjax.scales(gaussians)), axis=-1).T
    return longest / second


figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 3.5))
for name, (gaussians, psnrs) in results.items():
    left.hist(np.clip(ratios(gaussians), 1, 2), np.linspace(1, 2, 40), histtype="step", label=f"{name} the loss")
    right.plot(np.convolve(psnrs, np.ones(8) / 8, "valid"), label=f"{name} the loss")
left.axvline(LIMIT, color="black", linestyle=":")
left.set_yscale("log")
left.set_xlabel("length over width")
right.set_xlabel("step")
right.set_ylabel("PSNR, mean of 8 steps, dB")
left.legend()
pyplot.show()

# %%
shares = {name: float(np.mean(ratios(gaussians) > 1.1 * LIMIT)) for name, (gaussians, _) in results.items()}
print(f"Gaussians beyond {1.1 * LIMIT:.2f}: {shares['without']:.1%} without the loss, {shares['with']:.1%} with it")
assert shares["with"] < 0.5 * shares["without"]

# %% [markdown]
# `gsjax.train(..., terms={"needles": needles})` takes the same function, and the settings of a phase give it a weight.
# A loss that reads depth or normals declares them: `gsjax.Term(function, needs={"depth", "normals"})`.
