# %% [markdown]
# # Write your own loss term
#
# A loss is a weighted sum of terms, and a term is a plain function. Here a new one is written, checked by hand, added
# to a training, and seen to do what it says.

# %%
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

from gsjax.analytic import solids
from gsjax.gaussians import Gaussians, scales
from gsjax.numerics import masked_mean
from gsjax.rendering import View
from gsjax.scene import Pixels, extent, frame_of
from gsjax.scene.batches import Batch
from gsjax.settings import Model, Phase, Schedule, Settings, Weights
from gsjax.training import initialize, optimizers
from gsjax.training.loop import fit
from gsjax.training.state import initial_state
from gsjax.training.terms import Term

# %% [markdown]
# ## What a term is
#
# A function of the Gaussians, of what one view shows of them, and of that view's photo; it returns one number. It is a
# *mean*, so that its weight means the same for any number of pixels and Gaussians.
#
# Ours is against needles: Gaussians more than 1.2 times as long as they are wide, which stick out of a surface when the
# camera moves. In logarithms of lengths it is a difference, and nothing is asked of those that are round enough.

# %%
LONGEST = 1.2


def excess(gaussians: Gaussians):
    """[N] how much longer than `LONGEST` times its second axis a Gaussian is, in log units; 0 where it is not."""
    _, second, longest = jnp.sort(jnp.log(scales(gaussians)), axis=-1).T
    return jnp.maximum(longest - second - jnp.log(LONGEST), 0)


def needles(gaussians: Gaussians, view: View, batch: Batch):
    """Mean excess of the visible Gaussians."""
    del batch
    return masked_mean(excess(gaussians), view.splats.projection.visible[0])


# %% [markdown]
# ## Check it by hand
#
# Three Gaussians: a ball, a needle of 2.4 times its width, and one just at the limit. Only the second answers, with log
# 2; and its gradient shortens the longest axis and widens the second, by the same factor.

# %%
points = np.zeros((3, 3))
three = initialize.from_points(points, np.full((3, 3), 0.5), capacity=3, sh_degree=0)
three = replace(three, log_scales=jnp.log(jnp.array([[1, 1, 1], [1, 2.4, 0.1], [1, 1.2, 0.1]], jnp.float32)))

np.testing.assert_allclose(excess(three), [0, np.log(2), 0], atol=1e-6)

gradient = jax.grad(lambda g: excess(g)[1])(three)
np.testing.assert_allclose(gradient.log_scales[1], [-1, 1, 0], atol=1e-6)

# %% [markdown]
# ## Give it a name and a weight
#
# A run takes a term under a name, with its inputs other than the image: `Term(loss, needs)`. This term reads the
# Gaussians; others need "depth", "normals" or "neighbor". An input that no term needs is not computed. A phase gives
# the name a weight. A bare function works too: its needs are detected. Before the first step every term is traced on
# shapes alone, so that a mistake is one line at once. Edit the function, run its cell again, and the next training
# compiles the new one.

# %%
own = {"needles": Term(needles, needs={"gaussians"})}

# %% [markdown]
# ## A scene to train on
#
# Eight small photos of the built-in scene, and points of a box around it to start from.

# %%
frames = []
for index, camera in enumerate(solids.cameras(8, (40, 40))):
    colors = np.rint(255 * np.asarray(solids.trace(camera).colors)).astype(np.uint8)
    frames.append(frame_of(f"{index}.png", np.asarray(camera.viewmat), np.asarray(camera.K), Pixels(colors)))

rng = np.random.default_rng(0)
low, high = np.array(solids.BOUNDS)
cloud = rng.uniform(low, high, (800, 3)), rng.uniform(0, 1, (800, 3))

# %% [markdown]
# ## Train without and with it
#
# A phase is a number of steps with its weights. `fit` is the loop that `gsjax train` runs, without run folder and
# scores.


# %%
def trained(weights):
    phase = Phase("plain", 120, weights)
    settings = Settings(schedule=Schedule(phases=(phase,)), model=Model(background="white", sh_degree=0))
    size = extent(tuple(frames))
    optimizer = optimizers.make_optimizer(settings.rates, size, phase.steps)
    state = initial_state(initialize.from_points(*cloud, capacity=800, sh_degree=0), optimizer)
    psnrs = []
    state = fit(
        settings,
        frames,
        size,
        state,
        optimizer,
        normal_source=lambda state: [],
        observe=lambda progress: psnrs.append(float(progress.metrics.psnr)),
        terms=own,
    )
    return state.gaussians, psnrs


plain, psnr_plain = trained(Weights())
rounder, psnr_rounder = trained(Weights(needles=0.2))


# %% [markdown]
# ## What it did
#
# The lengths over widths of all Gaussians: the long ones are gone, the photos are fitted almost as well.


# %%
def ratios(gaussians):
    _, second, longest = np.sort(np.asarray(gaussians.log_scales), axis=-1).T
    return np.exp(longest - second)


figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 3.5))
bins = np.linspace(1, 2, 40)
for name, gaussians, psnr in (("plain", plain, psnr_plain), ("with the term", rounder, psnr_rounder)):
    left.hist(np.clip(ratios(gaussians), 1, 2), bins, histtype="step", label=name)
    right.plot(np.convolve(psnr, np.ones(8) / 8, "valid"), label=name)
left.axvline(LONGEST, color="black", linestyle=":")
left.set_yscale("log")
left.set_xlabel("longest over second axis")
right.set_xlabel("step")
right.set_ylabel("PSNR, mean of 8 steps, dB")
left.legend()
pyplot.show()

# %%
share, share_with = (float(np.mean(ratios(gaussians) > 1.1 * LONGEST)) for gaussians in (plain, rounder))
print(f"longer than {1.1 * LONGEST:.2f} times their width: {share:.1%} without the term, {share_with:.1%} with it")
assert share_with < 0.5 * share
