# %% [markdown]
# # The gradient of a signed distance, and the regulariser
#
# A rendered depth map implies a surface, and with it a signed distance. The gradient of this distance is the normal of
# the surface. The paper takes the gradient by automatic differentiation, composites it like a colour and aligns it with
# given normals. This notebook does so step by step on a plane, where every result has a closed form.

# %%
import jax
import jax.numpy as jnp
import numpy as np
import optax
from matplotlib import pyplot

import gsjax

# %% [markdown]
# ## A camera and a plane
#
# The camera is at the origin and looks along z, so world and camera axes are equal: x right, y down. The plane contains
# the point (0, 0, 4). Its unit normal faces the camera.

# %%
WIDTH, HEIGHT, FOCAL = 48, 40, 44.0
K = jnp.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
camera = gsjax.Camera(jnp.eye(4), K, WIDTH, HEIGHT)


def tilted(degrees):
    """Normal of a plane that is turned about the y axis."""
    angle = np.radians(degrees)
    return jnp.array([np.sin(angle), 0.0, -np.cos(angle)], jnp.float32)


normal = tilted(35)

# %% [markdown]
# A pixel's ray r (with z = 1) meets the plane at the depth z = (n . p0) / (n . r).

# %%
rays = gsjax.pixel_rays(camera)
depth = (normal[2] * 4.0) / jnp.sum(rays * normal, axis=-1)
pyplot.imshow(depth)
pyplot.colorbar(label="depth of the plane")
pyplot.show()


# %% [markdown]
# ## The estimate of the signed distance
#
# The paper's estimate is f(p) = D(pi(p)) - z(p): the depth map at the projection of p, minus the depth of p. It is
# positive between the camera and the surface, zero on the surface and negative behind it.


# %%
def signed_distance(point):
    return gsjax.depth_sdf(point, depth, camera)


on_plane = depth[20, 30] * rays[20, 30]
shares = jnp.array([0.5, 0.9, 1.0, 1.1])
along_ray = jax.vmap(lambda share: signed_distance(share * on_plane))(shares)
np.testing.assert_allclose(along_ray, (1 - shares) * on_plane[2], atol=1e-5)

# %% [markdown]
# ## Its gradient
#
# `jax.grad` differentiates the projection and the bilinear reading of the depth map. The gradient points towards the
# camera, where f grows. Its direction is the normal, up to a third of a degree of the bilinear reading.

# %%
gradient = jax.grad(signed_distance)(on_plane)
length = jnp.linalg.norm(gradient)
print("gradient / length:", np.round(np.asarray(gradient / length), 3), " normal:", np.round(np.asarray(normal), 3))
np.testing.assert_allclose(gradient / length, normal, atol=1e-2)

# %% [markdown]
# Its length is 1 / abs(n . r), because f is measured along the ray, which is longer than the distance to a slanted
# plane. The length depends on the viewing angle alone, so only the direction is used.

# %%
np.testing.assert_allclose(length, 1 / abs(jnp.sum(normal * rays[20, 30])), rtol=2e-2)

# %% [markdown]
# A cut through the scene at the height of the camera shows f in colours, the plane where f is zero, and gradients.

# %%
x, z = np.meshgrid(np.linspace(-1.4, 1.4, 60), np.linspace(2.6, 5.4, 60))
cut = jnp.asarray(np.stack([x, np.zeros_like(x), z], -1).reshape(-1, 3), jnp.float32)
values = jax.vmap(signed_distance)(cut).reshape(x.shape)
some = cut.reshape(60, 60, 3)[5:-5:10, 5:-5:10].reshape(-1, 3)
arrows = jax.vmap(jax.grad(signed_distance))(some)

pyplot.contourf(x, z, values, 21, cmap="coolwarm", vmin=-2.5, vmax=2.5)
pyplot.colorbar(label="f")
pyplot.contour(x, z, values, [0.0], colors="black")
pyplot.quiver(some[:, 0], some[:, 2], arrows[:, 0], arrows[:, 2], angles="xy", width=0.004)
pyplot.gca().set_aspect("equal")
pyplot.xlabel("x")
pyplot.ylabel("z, away from the camera")
pyplot.show()


# %% [markdown]
# ## A plane of Gaussians
#
# The surface is now a grid of flat Gaussians instead of a formula.

# %%
SIDE, SPACING = 14, 0.32
grid = (np.arange(SIDE) - (SIDE - 1) / 2) * SPACING
right, down = (jnp.asarray(part.ravel(), jnp.float32) for part in np.meshgrid(grid, grid))
FRONTAL = {
    "quats": jnp.tile(jnp.array([[1.0, 0.0, 0.0, 0.0]]), (SIDE**2, 1)),
    "log_scales": jnp.tile(jnp.log(jnp.array([[SPACING, SPACING, 0.02 * SPACING]])), (SIDE**2, 1)),
    "logit_opacities": jnp.full(SIDE**2, 3.0),
    "sh_dc": jnp.zeros((SIDE**2, 1, 3)),
    "sh_rest": jnp.zeros((SIDE**2, 0, 3)),
}


def plane_of_gaussians(degrees):
    """Centres on the tilted plane; each Gaussian turned with it, about y."""
    half = np.radians(-degrees) / 2
    quats = jnp.tile(jnp.array([[np.cos(half), 0.0, np.sin(half), 0.0]], jnp.float32), (SIDE**2, 1))
    out_of_plane = tilted(degrees)
    means = jnp.stack([-right * out_of_plane[2], down, 4 + right * out_of_plane[0]], -1)
    return gsjax.Gaussians(**{**FRONTAL, "quats": quats}, means=means)


# %% [markdown]
# ## From the Gaussians to a map of directions
#
# `gsjax.sdf_gradient` renders the depth and takes the gradient of f at the mean of every visible Gaussian. It makes the
# gradients unit vectors in the camera's frame, and composites them like colours. Inside `jit` a GPU needs a `capacity`,
# the maximum number of (tile, Gaussian) pairs. The number of pairs is checked once.

# %%
CAPACITY = 8192
pairs = gsjax.render(plane_of_gaussians(35), camera, capacity=CAPACITY).splats.pairs
assert pairs.needed < CAPACITY / 2


@jax.jit
def field_of(gaussians):
    """[H, W, 3] unit directions, and [H, W] where the plane covers the image."""
    field = gsjax.sdf_gradient(gaussians, camera, capacity=CAPACITY)
    covered = gsjax.render(gaussians, camera, capacity=CAPACITY).alphas > 0.9
    return field / jnp.sqrt(jnp.maximum(jnp.sum(field**2, axis=-1, keepdims=True), 1e-12)), covered


def mean_direction(field, covered):
    mean = jnp.sum(jnp.where(covered[..., None], field, 0), (0, 1))
    return mean / jnp.linalg.norm(mean)


for degrees in (0, 20, 35):
    direction = mean_direction(*field_of(plane_of_gaussians(degrees)))
    error = np.degrees(np.arccos(min(1.0, float(direction @ tilted(degrees)))))
    print(f"plane tilted by {degrees:2} degrees: error of the map {error:.2f} degrees")
    assert error < 2

# %% [markdown]
# ## The regulariser
#
# R is the mean of 1 - abs(cos) between the map and given normals. It is 0 where they are parallel or opposite, so the
# sign of a normal has no effect. For constant normals it has a closed form. In a training loop, R is the loss
# `sdf_normal`, and `gsjax.align_normals` makes R of your own estimator.


# %%
def regulariser(field, covered, normal):
    misalignment = 1 - jnp.abs(field @ normal)
    return jnp.sum(jnp.where(covered, misalignment, 0)) / jnp.sum(covered)


frontal = field_of(plane_of_gaussians(0))
angles = np.arange(0, 181, 10)
R = np.array([float(regulariser(*frontal, tilted(degrees))) for degrees in angles])
np.testing.assert_allclose(R, 1 - np.abs(np.cos(np.radians(angles))), atol=0.02)

pyplot.plot(angles, R, "o-", label="R of the Gaussians")
pyplot.plot(angles, 1 - np.abs(np.cos(np.radians(angles))), "k:", label="1 - abs(cos)")
pyplot.xlabel("angle between plane and given normals, degrees")
pyplot.legend()
pyplot.show()


# %% [markdown]
# ## Descend
#
# A frontal plane of Gaussians starts with normals of a plane that is tilted by 20 degrees. The means and rotations
# minimise R alone. The formula that the paper prints *adds* the sum of abs(cos): its minimum has surface and normals at
# right angles.

# %%
target = tilted(20)


def descend(loss_of_R, steps=40):
    """Angle between the mean direction and the target, before every step."""
    optimizer, gaussians = optax.adam(0.015), plane_of_gaussians(0)
    free = gaussians.means, gaussians.quats

    @jax.jit
    def step(free, moments):
        def loss(free):
            means, quats = free
            field, covered = field_of(gsjax.Gaussians(**{**FRONTAL, "quats": quats}, means=means))
            return loss_of_R(regulariser(field, covered, target)), mean_direction(field, covered) @ target

        (_, cosine), gradient = jax.value_and_grad(loss, has_aux=True)(free)
        updates, moments = optimizer.update(gradient, moments)
        return optax.apply_updates(free, updates), moments, cosine

    moments, cosines = optimizer.init(free), []
    for _ in range(steps):
        free, moments, cosine = step(free, moments)
        cosines.append(float(cosine))
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


complement = descend(lambda R: R)
printed = descend(lambda R: 1 - R)  # the mean of abs(cos)

# %%
pyplot.plot(complement, label="minimise R = mean(1 - abs(cos))")
pyplot.plot(printed, label="minimise mean(abs(cos)), as printed")
pyplot.xlabel("step")
pyplot.ylabel("angle to the target normal, degrees")
pyplot.legend()
pyplot.show()

# %%
assert complement[-1] < 0.3 * complement[0]
assert printed[-1] > printed[0]

# %% [markdown]
# In training the photos determine the surface as well, and R has a small weight. [Deviations](../deviations.md) and
# [the paper, line by line](../paper_map.md) give the reading of the text that gsjax has, and measure the others.
